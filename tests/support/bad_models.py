"""A valid model file and many small edits of it that make it wrong."""

GOOD = """\
name = "robot"
description = "for tests"
gravity = [0.0, 0.0, -9.81]
home_deg = [10.0, 20.0, -30.0]

[base]
position = [0.0, 0.0, 0.5]
rpy_deg = [0, 0, 90]

[[element]]
name = "first"
body = { mass = 10.0, com = [0.1, 0.0, 0.0], inertia = [1.0, 1.0, 1.0], rotational_drag = 0.1 }

[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, 0, 2]
lower_deg = -170
upper_deg = 170
friction = { viscous = 1.0 }

[element.dof.gear]
type = "elastic"
side = "motor"
spring = { type = "smooth", low = 1.0, high = 2.0, break_at = 0.1 }
damping = 0.5

[[element.dof]]
name = "e1"
type = "translation"
axis = [1, 0, 0]
spring = { type = "linear", stiffness = 1e5 }
damping = 10.0

[[element]]
name = "second"
origin = { position = [0.5, 0, 0] }
body = { mass = 5.0, inertia = [
    0.5, 0.5,
    0.5, 0.01, 0.0, 0.0,
] }

[[element.dof]]
name = "q2"
type = "rotation"
axis = [0, 1, 0]
gear = { type = "rigid" }

[[element.dof]]
name = "q3"
type = "rotation"
axis = [1, 0, 0]
gear = { type = "rigid" }

[element.beam]
length = 0.5
mass_per_length = 1.0
bending = [{ direction = "y", stiffness = 100.0, modes = 2, damping_ratio = 0.01 }]

[[motor]]
name = "m1"
drives = "q1"
ratio = -100
inertia = 1e-3
friction = { coulomb = 0.3, beta = 10.0 }
torque_max = 20.0

[[motor]]
name = "m2"
drives = ["q2", "q3"]
ratio = [50.0, 0.5]
inertia = 1e-3

[[motor]]
name = "m3"
drives = ["q3"]
ratio = 40.0
inertia = 1e-3

[payload]
mass = 1.0

[output]
type = "tool_position"
axes = "xyz"

[[move]]
name = "line"
type = "tool_line"
start_deg = [10, 20, -30]
displacement = [0.1, 0.0, 0.0]
duration = 0.5
smoothness = 5

[[move]]
name = "turn"
type = "joint"
start_rad = [0.0, 0.0, 0.0]
end_rad = [0.1, 0.2, 0.3]
duration = 1
smoothness = 3

[variant.stiff]
description = "rigid first gear"
set = { "element.first.dof.q1.gear" = { type = "rigid" } }
remove = ["motor.m1.friction"]
"""

# Each case: edits of GOOD (the first occurrence of a text and what replaces it), the key that must
# be named, and words that must follow in "given ..., expected ...". The comment "#!" marks the
# line that must be named.
CASES = {
    # the root
    "unknown key": ([("gravity =", "colour = 3 #!\ngravity =")], "colour", ["unknown key"]),
    "misspelt key": (
        [('description = "for tests"', 'sourse = "x" #!')],
        "sourse",
        ["unknown", "source"],
    ),
    "no name": ([('name = "robot"', "#!")], "name", ["given nothing", "string"]),
    "name is not an identifier": (
        [('"robot"', '"my robot" #!')],
        "name",
        ['"my robot"', "letter"],
    ),
    "name is a keyword": ([('"robot"', '"while" #!')], "name", ["while", "reserved"]),
    "name is a number": ([('"robot"', "3 #!")], "name", ["given 3", "a string"]),
    "gravity of two": (
        [("[0.0, 0.0, -9.81]", "[0.0, -9.81] #!")],
        "gravity",
        ["[0.0, -9.81]", "3 numbers"],
    ),
    "gravity is a date": (
        [("[0.0, 0.0, -9.81]", "2020-01-01 #!")],
        "gravity",
        ["2020-01-01", "3 numbers"],
    ),
    "gravity nan": ([("-9.81]", "nan] #!")], "gravity", ["nan", "3 numbers"]),
    "gravity infinite": ([("-9.81]", "-inf] #!")], "gravity", ["-inf", "3 numbers"]),
    "coupling": (
        [("[base]", 'motor_coupling = "full" #!\n[base]')],
        "motor_coupling",
        ['"full"', "complete"],
    ),
    "home without unit": (
        [("home_deg = [10.0, 20.0, -30.0]", "home = [0, 0, 0] #!")],
        "home",
        ["home_rad or home_deg"],
    ),
    "home in both units": (
        [("home_deg", "home_rad = [0, 0, 0]\nhome_deg")],
        "home_deg",
        ["both home_rad and home_deg"],
    ),
    "home too short": (
        [("[10.0, 20.0, -30.0]", "[10.0, 20.0] #!")],
        "home_deg",
        ["3 numbers", "q1, q2, q3"],
    ),
    "home outside limits": (
        [("[10.0, 20.0,", "[190.0, 20.0,")],
        "home_deg",
        ["q1 = 3.31613", "limits -2.96706..2.96706"],
    ),
    "base is a list": (
        [("[base]\nposition = [0.0, 0.0, 0.5]\nrpy_deg = [0, 0, 90]", "base = [1] #!")],
        "base",
        ["a table"],
    ),
    "base rotation without unit": ([("rpy_deg", "rpy")], "base.rpy", ["rpy_rad or rpy_deg"]),
    "base rotation in both units": (
        [("rpy_deg = [0, 0, 90]", "rpy_rad = [0, 0, 0]\nrpy_deg = [0, 0, 90] #!")],
        "base.rpy_deg",
        ["both", "one of the two"],
    ),
    # elements and bodies
    "element twice": (
        [('name = "second"', 'name = "first" #!')],
        "element.first.name",
        ['"first"', "not taken"],
    ),
    "element called base": (
        [('name = "second"', 'name = "base" #!')],
        "element.base.name",
        ["the ground"],
    ),
    "element with two parents": (
        [('name = "first"', 'name = "first"\nparent = ["base", "second"] #!')],
        "element.first.parent",
        ["the name of one element", "closes a loop"],
    ),
    "element without name": (
        [('[[element]]\nname = "first"', "[[element]] #!")],
        "element[0].name",
        ["nothing"],
    ),
    "negative mass": (
        [("mass = 10.0", "mass = -1")],
        "element.first.body.mass",
        ["given -1", ">= 0"],
    ),
    "mass is text": (
        [("mass = 10.0", 'mass = "10 kg"')],
        "element.first.body.mass",
        ['"10 kg"', "a number"],
    ),
    "mass is a truth value": (
        [("mass = 10.0", "mass = true")],
        "element.first.body.mass",
        ["given true", "a number"],
    ),
    "mass is huge": (
        [("mass = 10.0", "mass = 1" + "0" * 400)],
        "element.first.body.mass",
        ["1000", "a number"],
    ),
    "mass is absurd": (
        [("mass = 10.0", "mass = 1e15")],
        "element.first.body.mass",
        ["given 1000000000000000.0, expected a number of magnitude 1e-18 to 1e12 (or 0)"],
    ),
    "mass is tiny": (
        [("mass = 10.0", "mass = 5e-324")],
        "element.first.body.mass",
        ["5e-324", "of magnitude"],
    ),
    "stiffness is absurd": (
        [("stiffness = 1e5", "stiffness = 1e308")],
        "element.first.dof.e1.spring.stiffness",
        ["1e+308", "of magnitude"],
    ),
    "gravity is absurd": ([("-9.81]", "-1e13] #!")], "gravity", ["numbers of magnitude"]),
    "gravity is tiny": ([("-9.81]", "-1e-300] #!")], "gravity", ["numbers of magnitude"]),
    "tiny ratio next to another": (
        [("[50.0, 0.5]", "[50.0, 1e-300] #!")],
        "motor.m2.ratio",
        ["magnitude", "write 0"],
    ),
    "control character": (
        [('"for tests"', '"red \\u001b[31m" #!')],
        "description",
        ['given the control character "\\x1b"', "without control characters"],
    ),
    "control character in a key": (
        [("gravity =", '"\\u001b[2J" = 3 #!\ngravity =')],
        '"\\x1b[2J"',
        ["unknown key"],
    ),
    "control character in a value": (
        [("mass = 10.0", 'mass = { "\\u001b" = 1 }')],
        "element.first.body.mass",
        ['{"\\x1b" = 1}'],
    ),
    "empty key": ([("gravity =", '"" = 3 #!\ngravity =')], '""', ["unknown key"]),
    "empty key in a table": ([("[base]", '[base]\n"" = 3 #!')], 'base.""', ["unknown key"]),
    "no mass": ([("mass = 10.0, ", "")], "element.first.body.mass", ["nothing"]),
    "inertia without mass": (
        [("mass = 10.0", "mass = 0")],
        "element.first.body.inertia",
        ["mass is 0"],
    ),
    "negative inertia": (
        [("inertia = [1.0, 1.0, 1.0]", "inertia = [1, 1, -0.1]")],
        "element.first.body.inertia",
        ["principal moments -0.1, 1, 1"],
    ),
    "inertia no body has": (
        [("inertia = [1.0, 1.0, 1.0]", "inertia = [1.0, 1.0, 2.1]")],
        "element.first.body.inertia",
        ["1, 1, 2.1", "sum of the other two"],
    ),
    "inertia not positive": (
        [("0.5, 0.01, 0.0", "0.5, 0.60, 0.0")],
        "element.second.body.inertia",
        ["principal moments -0.1, 0.5, 1.1"],
    ),
    "inertia of four": (
        [("[1.0, 1.0, 1.0]", "[1.0, 1.0, 1.0, 0]")],
        "element.first.body.inertia",
        ["3 or 6"],
    ),
    "text in a long list": (
        [("0.01, 0.0, 0.0", '"0" #!\n, 0.0, 0.0')],
        "element.second.body.inertia",
        ["3 or 6"],
    ),
    "negative drag": (
        [("drag = 0.1", "drag = -0.1")],
        "element.first.body.rotational_drag",
        [">= 0"],
    ),
    "unit of the body": ([("com =", "com_mm =")], "element.first.body.com_mm", ["unknown", "com"]),
    # degrees of freedom
    "dof twice": (
        [('name = "q2"', 'name = "q1" #!')],
        "element.second.dof.q1.name",
        ["not taken"],
    ),
    "dof like a mode": (
        [('name = "e1"', 'name = "second_y1"')],
        "element.second.beam.bending[0].modes",
        ["coordinate second_y1", "not taken"],
    ),
    "dof type": (
        [('"rotation"', '"revolute" #!')],
        "element.first.dof.q1.type",
        ['"revolute"', "rotation"],
    ),
    "no axis": (
        [("axis = [0, 0, 2]\n", ""), ("[[element.dof]]", "[[element.dof]] #!")],
        "dof.q1.axis",
        ["nothing"],
    ),
    "axis of zero length": (
        [("axis = [0, 0, 2]", "axis = [0, 0, 0] #!")],
        "element.first.dof.q1.axis",
        ["not zero"],
    ),
    "axis of four": (
        [("axis = [0, 0, 2]", "axis = [0, 0, 0, 1] #!")],
        "element.first.dof.q1.axis",
        ["3 numbers"],
    ),
    "axis is text": (
        [("axis = [0, 0, 2]", 'axis = "z" #!')],
        "element.first.dof.q1.axis",
        ['"z"', "3 numbers"],
    ),
    "limit without unit": (
        [("lower_deg", "lower")],
        "element.first.dof.q1.lower",
        ["lower_rad or lower_deg"],
    ),
    "limit of a translation in degrees": (
        [("axis = [1, 0, 0]", "lower_deg = 1 #!\naxis = [1, 0, 0]")],
        "element.first.dof.e1.lower_deg",
        ["a key of type =", "lower"],
    ),
    "limits crossed": (
        [("lower_deg = -170", "lower_deg = 171")],
        "element.first.dof.q1.lower_deg",
        ["below"],
    ),
    "neither gear nor spring": (
        [
            ('gear = { type = "rigid" }\n', ""),
            ('[[element.dof]]\nname = "q2"', '[[element.dof]] #!\nname = "q2"'),
        ],
        "element.second.dof.q2.gear",
        ["given nothing", "a spring (non-actuated)"],
    ),
    "both gear and spring": (
        [
            (
                'gear = { type = "rigid" }',
                'gear = { type = "rigid" }\nspring = { type = "linear", stiffness = 1.0 } #!',
            )
        ],
        "element.second.dof.q2.spring",
        ["both a spring and a gear"],
    ),
    "damping in addition to a gear": (
        [('gear = { type = "rigid" }', 'gear = { type = "rigid" }\ndamping = 1.0 #!')],
        "element.second.dof.q2.damping",
        ["inside the gear"],
    ),
    "speed limit": (
        [("lower_deg = -170", "speed_max = 0 #!")],
        "element.first.dof.q1.speed_max",
        ["> 0"],
    ),
    "negative damping": (
        [("damping = 0.5", "damping = -0.5")],
        "element.first.dof.q1.gear.damping",
        [">= 0"],
    ),
    "gear type": ([('"elastic"', '"stiff" #!')], "element.first.dof.q1.gear.type", ["elastic"]),
    "gear side": (
        [('side = "motor"', 'side = "gear" #!')],
        "element.first.dof.q1.gear.side",
        ["arm, motor"],
    ),
    "no gear side": (
        [('side = "motor"\n', ""), ("[element.dof.gear]", "[element.dof.gear] #!")],
        "element.first.dof.q1.gear.side",
        ["nothing", "arm, motor"],
    ),
    "rigid gear with damping": (
        [('"elastic"', '"rigid"'), ('side = "motor"', "")],
        "q1.gear.spring",
        ["rigid gear without"],
    ),
    "spring type": (
        [('"smooth"', '"smoth"')],
        "element.first.dof.q1.gear.spring.type",
        ['"smoth"', "smooth"],
    ),
    "spring key": (
        [("high = 2.0", "stiffness = 2.0")],
        "element.first.dof.q1.gear.spring.stiffness",
        ['a key of type = "linear"'],
    ),
    "negative stiffness": (
        [("stiffness = 1e5", "stiffness = -1e5")],
        "element.first.dof.e1.spring.stiffness",
        [">= 0"],
    ),
    "gear without stiffness": (
        [("low = 1.0", "low = 0.0")],
        "element.first.dof.q1.gear.spring.low",
        ["> 0"],
    ),
    "friction key": (
        [("viscous = 1.0", "viskous = 1.0")],
        "element.first.dof.q1.friction.viskous",
        ["viscous"],
    ),
    "negative friction": (
        [("viscous = 1.0", "viscous = -1.0")],
        "element.first.dof.q1.friction.viscous",
        [">= 0"],
    ),
    "Coulomb without beta": (
        [(", beta = 10.0", "")],
        "motor.m1.friction.beta",
        ["nothing", "together with coulomb"],
    ),
    "Stribeck without alpha": (
        [("coulomb = 0.3", "stribeck = 0.3")],
        "motor.m1.friction.alpha",
        ["stribeck"],
    ),
    # beam
    "beam length": ([("length = 0.5", "length = 0.0 #!")], "element.second.beam.length", ["> 0"]),
    "beam direction": (
        [('direction = "y"', 'direction = "x"')],
        "element.second.beam.bending[0].direction",
        ["y, z"],
    ),
    "beam without modes": (
        [("modes = 2", "modes = 0")],
        "element.second.beam.bending[0].modes",
        ["from 1 to"],
    ),
    "beam modes as float": (
        [("modes = 2", "modes = 2.0")],
        "element.second.beam.bending[0].modes",
        ["whole number"],
    ),
    "beam damping": (
        [("damping_ratio = 0.01", "damping_ratio = 1")],
        "bending[0].damping_ratio",
        ["below 1"],
    ),
    # motors
    "motor twice": ([('name = "m2"', 'name = "m1" #!')], "motor.m1.name", ["not taken"]),
    "unknown joint": ([('drives = "q1"', 'drives = "q9" #!')], "motor.m1.drives", ['"q9"', "q1"]),
    "joint without gear": (
        [('drives = "q1"', 'drives = "e1" #!')],
        "motor.m1.drives",
        ["e1", "with a gear"],
    ),
    "elastic and rigid coupled": (
        [('"q2", "q3"]', '"q1", "q3"] #!')],
        "motor.m2.drives",
        ["all rigid"],
    ),
    "undriven joint": (
        [
            ('["q2", "q3"]', '["q3"]'),
            ("[50.0, 0.5]", "50.0"),
            ('gear = { type = "rigid" }', 'gear = { type = "rigid" } #!'),
        ],
        "element.second.dof.q2.gear",
        ["no motor", "drives q2"],
    ),
    "motor side of a shared joint": (
        [
            ('"q3"]\nratio = 40.0', '"q1"]\nratio = 40.0'),
            ("[element.dof.gear]", "[element.dof.gear] #!"),
        ],
        "element.first.dof.q1.gear",
        ['side = "arm"'],
    ),
    "too many motors": (
        [
            (
                "[payload]",
                '[[motor]]\nname = "m4"\ndrives = "q3"\nratio = 1.0\ninertia = 1.0\n[payload]',
            )
        ],
        "motor",
        ["4 motors", "3"],
    ),
    "singular ratios": (
        [('drives = ["q3"]', 'drives = ["q2", "q3"]'), ("ratio = 40.0", "ratio = [100.0, 1.0]")],
        "motor",
        ["singular matrix"],
    ),
    "zero ratio": ([("ratio = -100", "ratio = 0 #!")], "motor.m1.ratio", ["not 0"]),
    "one ratio for two joints": (
        [("[50.0, 0.5]", "50.0 #!")],
        "motor.m2.ratio",
        ["list of 2 numbers"],
    ),
    "three ratios for two joints": (
        [("[50.0, 0.5]", "[50.0, 0.5, 1] #!")],
        "motor.m2.ratio",
        ["list of 2 numbers"],
    ),
    "no rotor inertia": ([("inertia = 1e-3", "inertia = 0.0 #!")], "motor.m1.inertia", ["> 0"]),
    "torque limit": (
        [("torque_max = 20.0", "torque_max = -20.0 #!")],
        "motor.m1.torque_max",
        ["> 0"],
    ),
    "complete without axis": (
        [("[base]", 'motor_coupling = "complete"\n[base]'), ("[[motor]]", "[[motor]] #!")],
        "motor.m1.axis",
        ["nothing", "complete"],
    ),
    "unknown carrier": (
        [("torque_max = 20.0", 'carrier = "frist" #!')],
        "motor.m1.carrier",
        ['"frist"', "first"],
    ),
    # output and moves
    "no output": (
        [('[output]\ntype = "tool_position"\naxes = "xyz"\n', "")],
        "output",
        ["nothing", "a table"],
    ),
    "output type": ([('"tool_position"', '"tool" #!')], "output.type", ['"tool"', "tool_pose"]),
    "output axes": ([('"xyz"', '"yx" #!')], "output.axes", ["in this order"]),
    "axes of a pose": (
        [('type = "tool_position"', 'type = "tool_pose"')],
        "output.axes",
        ["a key of type ="],
    ),
    "output joint": (
        [('type = "tool_position"\naxes = "xyz"', 'type = "joint"\njoints = ["q1", "q4"] #!')],
        "output.joints",
        ["q4", "q3"],
    ),
    "output row": (
        [
            (
                'type = "tool_position"\naxes = "xyz"',
                'type = "combination"\nunit = "m"\nrows = [\n{ q1 = 1 },\n{ q7 = 2 }, #!\n]',
            )
        ],
        "output.rows[1].q7",
        ["unknown"],
    ),
    "output rows depend": (
        [
            (
                'type = "tool_position"\naxes = "xyz"',
                'type = "combination"\nunit = "m"\nrows = [{ q1 = 1 }, { q1 = 2 }] #!',
            )
        ],
        "output.rows",
        ["depend"],
    ),
    "output row of zeros": (
        [
            (
                'type = "tool_position"\naxes = "xyz"',
                'type = "combination"\nunit = "m"\nrows = [{ q1 = 0 }] #!',
            )
        ],
        "output.rows[0]",
        ["not 0"],
    ),
    "move twice": ([('name = "turn"', 'name = "line" #!')], "move.line.name", ["not taken"]),
    "move type": ([('"tool_line"', '"line" #!')], "move.line.type", ["tool_line"]),
    "move start": (
        [("start_deg = [10, 20, -30]", "start_deg = [10] #!")],
        "move.line.start_deg",
        ["3 numbers"],
    ),
    "move without start": (
        [("start_rad = [0.0, 0.0, 0.0]\n", "")],
        "move.turn.start_rad",
        ["start_rad or start_deg"],
    ),
    "move end": ([("end_rad", "end")], "move.turn.end", ["end_rad or end_deg"]),
    "move start outside limits": (
        [("[10, 20, -30]", "[180, 20, -30] #!")],
        "move.line.start_deg",
        ["limits"],
    ),
    "move displacement": (
        [("[0.1, 0.0, 0.0]\nd", "[0.1, 0.0] #!\nd")],
        "move.line.displacement",
        ["3 numbers"],
    ),
    "move duration": ([("duration = 0.5", "duration = 0.0 #!")], "move.line.duration", ["> 0"]),
    "move too rough": (
        [("smoothness = 5", "smoothness = 2 #!")],
        "move.line.smoothness",
        ["3 to 9"],
    ),
    "move smoothness as float": (
        [("smoothness = 5", "smoothness = 5.5 #!")],
        "move.line.smoothness",
        ["3 to 9"],
    ),
    "move rotation without pose": (
        [("smoothness = 5", "smoothness = 5\nrotation_deg = [0, 0, 10] #!")],
        "move.line.rotation_deg",
        ["tool_pose"],
    ),
    "move of the outputs of a tool": (
        [('"tool_line"', '"output_line" #!')],
        "move.line.type",
        ["tool_line"],
    ),
    # variants
    "variant path": (
        [
            (
                '"element.first.dof.q1.gear" = { type = "rigid" } }',
                '"element.first.dof.q9.gear" = 1 } #!',
            )
        ],
        'variant.stiff.set."element.first.dof.q9.gear"',
        ["q9", "e1, q1"],
    ),
    "variant removes nothing": (
        [('["motor.m1.friction"]', '["motor.m2.friction"] #!')],
        "variant.stiff.remove",
        ["friction"],
    ),
    "variant key": ([("remove =", "delete =")], "variant.stiff.delete", ["unknown", "remove"]),
    "variant name": (
        [("[variant.stiff]", '[variant."very stiff"]')],
        'variant."very stiff"',
        ["letter"],
    ),
    "variant is not a table": (
        [("[base]", "variant = 3 #!\n[base]"), ("[variant.stiff]", "[stiff]")],
        "variant",
        ["a table"],
    ),
    # the text
    "no TOML": (
        [("mass = 10.0", "mass = = 10")],
        "file",
        ["given text that is not TOML (invalid value), expected TOML 1.0"],
    ),
    "no line end": (
        [("gravity =", "a = 1 b = 2 #!\ngravity =")],
        "file",
        ["given text that is not TOML (expected newline", "), expected TOML 1.0"],
    ),
    "key twice": ([("gravity", 'name = "again" #!\ngravity')], "file", ["not TOML", "overwrite"]),
    "deep nesting": (
        [("gravity", "deep = " + "[" * 900 + "]" * 900 + "\ngravity")],
        "file",
        ["nested too deeply"],
    ),
    "somewhat deep nesting": (
        [("gravity", "deep = " + "[" * 20 + "]" * 20 + "\ngravity")],
        "file",
        ["nested too deeply"],
    ),
    "deep key": (
        [("gravity", ".".join("abcd" * 200) + " = 1\ngravity")],
        "file",
        ["nested too deeply"],
    ),
    "long line": (
        [("gravity", "long = '" + "x" * 5000 + "' #!\ngravity")],
        "file",
        ["5012 characters"],
    ),
}


def edited(edits):
    text = GOOD
    for old, new in edits:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text
