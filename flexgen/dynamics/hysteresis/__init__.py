"""Elements with a state, in addition to the equations of motion: hysteresis of gears, friction of
motors.
"""
