"""Function blocks of IEC 61131-3 around an emitted library: `export_plcopen`."""
