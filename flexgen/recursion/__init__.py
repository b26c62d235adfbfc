"""The functions of the equations by recursions specialised to one robot."""
