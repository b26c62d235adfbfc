"""A valid URDF file, an overlay on it, and many small edits of them that make them wrong."""

URDF = """\
<?xml version="1.0"?>
<robot name="arm">
  <material name="grey"/>
  <link name="world"/>
  <joint name="anchor" type="fixed">
    <parent link="world"/>
    <child link="foot"/>
    <origin xyz="0 0 0.1" rpy="0 0 0.5"/>
  </joint>
  <link name="foot"/>
  <joint name="turn" type="continuous">
    <parent link="foot"/>
    <child link="column"/>
    <axis xyz="0 0 1"/>
    <limit effort="100" velocity="2"/>
  </joint>
  <link name="column">
    <inertial>
      <origin xyz="0 0 0.3" rpy="0 0.1 0"/>
      <mass value="12"/>
      <inertia ixx="0.4" ixy="0" ixz="0.01" iyy="0.4" iyz="0" izz="0.1"/>
    </inertial>
    <visual><geometry><sphere radius="0.1"/></geometry></visual>
  </link>
  <joint name="lift" type="revolute">
    <parent link="column"/>
    <child link="boom"/>
    <origin xyz="0.1 0 0.6" rpy="0.2 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="200" velocity="2"/>
    <dynamics damping="0.5" friction="0"/>
  </joint>
  <link name="boom">
    <inertial>
      <origin xyz="0.3 0 0"/>
      <mass value="6"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.3"/>
    </inertial>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="boom"/>
    <child link="ram"/>
    <origin xyz="0.5 0 0"/>
    <axis xyz="1 0 0"/>
    <limit lower="0.1" upper="0.5" effort="300" velocity="1"/>
  </joint>
  <link name="ram">
    <inertial>
      <mass value="2"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/>
    </inertial>
  </link>
  <joint name="finger" type="prismatic">
    <parent link="ram"/>
    <child link="jaw"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="0.1" effort="10" velocity="1"/>
  </joint>
  <link name="jaw">
    <inertial>
      <mass value="0.2"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/>
    </inertial>
  </link>
  <joint name="end" type="fixed">
    <parent link="ram"/>
    <child link="tip"/>
    <origin xyz="0.2 0 0"/>
  </joint>
  <link name="tip"/>
</robot>
"""

OVERLAY = """\
name = "arm"
home_rad = [0.1, 0.2, 0.3]

[urdf]
file = "arm.urdf"
base = "world"
tip = "tip"
lock = { finger = 0.05 }

[joint.turn]
motor = { ratio = 50.0, inertia = 1e-3 }

[joint.lift]
rename = "q2"
gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = 1e4 }, damping = \
5.0 }
motor = { ratio = -80.0, inertia = 1e-3, friction = { viscous = 1e-3 } }

[[joint.lift.after]]
name = "bend"
type = "rotation"
axis = [0, 0, 1]
spring = { type = "linear", stiffness = 2e4 }

[link.boom]
rename = "arm2"

[variant.direct]
set = { "element.arm2.dof.q2.gear" = { type = "rigid" }, "motor.m2.inertia" = 0.0 }
"""

FINGER = "lock = { finger = 0.05 }\n"
LIFT = '<limit lower="-1" upper="1" effort="200" velocity="2"/>'
BOOM = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.3"/>'
RAM = """\
    <inertial>
      <mass value="2"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/>
    </inertial>
"""
JAW = """\
    <inertial>
      <mass value="0.2"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/>
    </inertial>
"""
LONG = "a_joint_name_of_forty_characters_or_more"
RLO = "evil\u202e\x7f"

# name: edits of the URDF file, end of the key, words of the message; the line of the error is
# marked by <!--!-->
BAD_URDF = {
    "empty file": ([(URDF, "")], "file", ["not XML"]),
    "text": ([(URDF, "robot arm")], "file", ["not XML", "syntax error"]),
    "cut off": ([('  <link name="tip"/>\n</robot>\n', "")], "file", ["not XML"]),
    "wrong end": ([("</robot>", "</robt><!--!-->")], "file", ["mismatched tag"]),
    "attribute twice": (
        [('<mass value="6"/>', '<mass value="6" value="7"/><!--!-->')],
        "file",
        ["duplicate attribute"],
    ),
    "not a robot": (
        [('<robot name="arm">', '<sdf name="arm"><!--!-->'), ("</robot>", "</sdf>")],
        "file",
        ["<robot"],
    ),
    "no name": ([('<robot name="arm">', "<robot><!--!-->")], "robot.name", ["given nothing"]),
    "empty name": (
        [('<link name="foot"/>', '<link name=" "/><!--!-->')],
        "link.name",
        ["an empty string"],
    ),
    "name of thousands": (
        [('"grey"', '"grey"'), ('<link name="tip"/>', f'<link name="{"x" * 3000}"/><!--!-->')],
        "link.name",
        ["3000 characters"],
    ),
    "document type": (
        [("<robot ", "<!DOCTYPE robot><robot ")],
        "file",
        ["document type", "without <!DOCTYPE"],
    ),
    "laughs": (
        [
            ("<robot ", '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><robot '),
            ('"grey"', '"&b;"'),
        ],
        "file",
        ["document type"],
    ),
    "external": (
        [("<robot ", '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot ')],
        "file",
        ["document"],
    ),
    "undefined entity": ([('"grey"', '"&grey;"')], "file", ["undefined entity"]),
    "deep": (
        [('<link name="tip"/>', "<a>" * 100 + "</a>" * 100)],
        "file",
        ["nested too deeply", "64"],
    ),
    "encoding": ([('version="1.0"', 'version="1.0" encoding="klingon"')], "file", ["encoding"]),
    "control character": ([('"grey"', '"gr\x01ey"')], "file", ["not XML", "invalid token"]),
    "xacro": (
        [
            ("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '),
            ('<material name="grey"/>', '<xacro:property name="w" value="1"/><!--!-->'),
        ],
        "file",
        ["xacro has expanded"],
    ),
    "xacro value": (
        [('<mass value="6"/>', '<mass value="${m}"/><!--!-->')],
        "mass.value",
        ["xacro"],
    ),
    "misspelled tag": (
        [
            ('<inertial>\n      <origin xyz="0.3', '<inertail><!--!-->\n      <origin xyz="0.3'),
            (
                'iyy="0.3" iyz="0" izz="0.3"/>\n    </inertial>',
                'iyy="0.3" iyz="0" izz="0.3"/>\n    </inertail>',
            ),
        ],
        "link.boom",
        ["inertail", "expected inertial"],
    ),
    "misspelled joint": (
        [
            ('<joint name="end" type="fixed">', '<Joint name="end" type="fixed"><!--!-->'),
            ('<origin xyz="0.2 0 0"/>\n  </joint>', '<origin xyz="0.2 0 0"/>\n  </Joint>'),
        ],
        "robot",
        ["Joint"],
    ),
    "link twice": (
        [('<link name="foot"/>', '<link name="foot"/><link name="foot"/><!--!-->')],
        "link.foot",
        ["line 10"],
    ),
    "joint twice": (
        [
            ('<joint name="lift" ', '<joint name="turn" '),
            ('type="revolute">', 'type="revolute"><!--!-->'),
        ],
        "joint.turn",
        ["line 11", "each joint once"],
    ),
    "origin twice": (
        [('<origin xyz="0.5 0 0"/>', '<origin xyz="0.5 0 0"/><origin/><!--!-->')],
        "joint.slide.origin",
        ["a second <origin>"],
    ),
    "inertial twice": (
        [('<link name="tip"/>', '<link name="tip"><inertial/><inertial/><!--!--></link>')],
        "link.tip.inertial",
        ["a second <inertial>"],
    ),
    "joint without a type": (
        [('name="lift" type="revolute">', 'name="lift"><!--!-->')],
        "joint.lift.type",
        ["nothing"],
    ),
    "unknown type": (
        [('type="revolute">', 'type="revolut"><!--!-->')],
        "joint.lift.type",
        ['"revolute" (there are:'],
    ),
    "floating": (
        [('type="revolute">', 'type="floating"><!--!-->')],
        "joint.lift.type",
        ["floating", "revolute, cont"],
    ),
    "planar": ([('type="revolute">', 'type="planar"><!--!-->')], "joint.lift.type", ["planar"]),
    "no parent": (
        [('<parent link="column"/>', ""), ('type="revolute">', 'type="revolute"><!--!-->')],
        "joint.lift.parent",
        ["<parent link="],
    ),
    "no child link": (
        [('<child link="boom"/>', "<child/><!--!-->")],
        "joint.lift.child.link",
        ["nothing"],
    ),
    "unknown parent": (
        [('<parent link="column"/>', '<parent link="colum"/><!--!-->')],
        "joint.lift.parent",
        ['unknown link "colum"', '"column" (there are:'],
    ),
    "unknown child": (
        [('<child link="boom"/>', '<child link="zzz"/><!--!-->')],
        "joint.lift.child",
        ["one of"],
    ),
    "two parents": (
        [
            ('<child link="jaw"/>', '<child link="tip"/>'),
            ('<joint name="end" type="fixed">', '<joint name="end" type="fixed"><!--!-->'),
        ],
        "joint.end.child",
        ["finger", "one parent"],
    ),
    "two roots": (
        [('<link name="foot"/>', '<link name="foot"/><link name="lost"/><!--!-->')],
        "robot",
        ["without a parent", '"lost"'],
    ),
    "loop": (
        [
            ('<parent link="column"/>', '<parent link="tip"/>'),
            ('<link name="boom">', '<link name="boom"><!--!-->'),
        ],
        "link.boom",
        ["loop"],
    ),
    "loop of one": (
        [
            ('<parent link="column"/>', '<parent link="boom"/>'),
            ('<link name="boom">', '<link name="boom"><!--!-->'),
        ],
        "link.boom",
        ["loop"],
    ),
    "everything in a loop": (
        [
            (
                '<robot name="arm">',
                (
                    '<robot name="arm"><joint name="back" type="fixed"><parent '
                    'link="tip"/><child link="world"/></joint>'
                ),
            ),
            ('<link name="world"/>', '<link name="world"/><!--!-->'),
        ],
        "link.world",
        ["loop"],
    ),
    "no links": ([(URDF, '<robot name="arm"/>')], "robot", ["no link"]),
    "zero axis": (
        [
            (
                '<axis xyz="0 1 0"/>\n    <limit lower="-1"',
                '<axis xyz="0 0 0"/><!--!-->\n    <limit lower="-1"',
            )
        ],
        "lift.axis.xyz",
        ["not zero"],
    ),
    "axis of two": (
        [('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/><!--!-->')],
        "turn.axis.xyz",
        ["3 numbers"],
    ),
    "axis without numbers": (
        [('<axis xyz="0 0 1"/>', "<axis/><!--!-->")],
        "turn.axis.xyz",
        ["nothing"],
    ),
    "word": (
        [
            ('xyz="0.5 0 0"', 'xyz="0.5 0 x"'),
            ('<child link="ram"/>\n', '<child link="ram"/><!--!-->'),
        ],
        "slide.origin.xyz",
        ['"0.5 0 x"', "3 numbers"],
    ),
    "comma": ([('xyz="0.5 0 0"/>', 'xyz="0,5 0 0"/><!--!-->')], "slide.origin.xyz", ["3 numbers"]),
    "underscore": (
        [('xyz="0.5 0 0"/>', 'xyz="1_0 0 0"/><!--!-->')],
        "slide.origin.xyz",
        ["3 numbers"],
    ),
    "hexadecimal": (
        [('<mass value="6"/>', '<mass value="0x10"/><!--!-->')],
        "boom.inertial.mass.value",
        ["a number"],
    ),
    "not a number": (
        [('<mass value="6"/>', '<mass value="nan"/><!--!-->')],
        "boom.inertial.mass.value",
        ["a number"],
    ),
    "infinite": (
        [('<mass value="6"/>', '<mass value="inf"/><!--!-->')],
        "boom.inertial.mass.value",
        ["a number"],
    ),
    "overflow": (
        [('<mass value="6"/>', '<mass value="1e999"/><!--!-->')],
        "boom.inertial.mass.value",
        ["at most 1e+12"],
    ),
    "huge": (
        [('<mass value="6"/>', '<mass value="1e13"/><!--!-->')],
        "boom.inertial.mass.value",
        ["at most 1e+12"],
    ),
    "digits of another script": (
        [('<mass value="6"/>', '<mass value="\u0666"/><!--!-->')],
        "mass.value",
        ["a number"],
    ),
    "rpy of four": (
        [('rpy="0.2 0 0"/>', 'rpy="0 0 0 1"/><!--!-->')],
        "lift.origin.rpy",
        ["3 numbers"],
    ),
    "negative mass": (
        [('<mass value="6"/>', '<mass value="-6"/><!--!-->')],
        "boom.inertial.mass.value",
        [">= 0"],
    ),
    "no mass": (
        [
            ('      <mass value="6"/>\n', ""),
            ('<inertial>\n      <origin xyz="0.3', '<inertial><!--!-->\n      <origin xyz="0.3'),
        ],
        "boom.inertial.mass",
        ["<mass> in <inertial>"],
    ),
    "no inertia": (
        [
            (f"      {BOOM}\n", ""),
            ('<inertial>\n      <origin xyz="0.3', '<inertial><!--!-->\n      <origin xyz="0.3'),
        ],
        "boom.inertial.inertia",
        ["<inertia> in <inertial>"],
    ),
    "inertia of five": (
        [(BOOM, BOOM.replace('iyz="0" ', "") + "<!--!-->")],
        "boom.inertial.inertia.iyz",
        ["nothing"],
    ),
    "inertia without mass": (
        [('<mass value="6"/>', '<mass value="0"/>'), (BOOM, BOOM + "<!--!-->")],
        "boom.inertial.inertia",
        ["without a mass"],
    ),
    "negative inertia": (
        [(BOOM, BOOM.replace("0.02", "-0.02") + "<!--!-->")],
        "boom.inertial.inertia",
        ["principal moments >= 0", "[link.boom] body"],
    ),
    "indefinite inertia": (
        [(BOOM, BOOM.replace('ixy="0"', 'ixy="0.5"') + "<!--!-->")],
        "boom.inertial.inertia",
        ["principal moments >= 0"],
    ),
    "triangle": (
        [(BOOM, BOOM.replace('izz="0.3"', 'izz="0.4"') + "<!--!-->")],
        "boom.inertial.inertia",
        ["sum of the other two", "[link.boom] inertia_reduced = true"],
    ),
    "no limits": (
        [(LIFT, ""), ('type="revolute">', 'type="revolute"><!--!-->')],
        "joint.lift.limit",
        ["<limit>", "[joint.lift] limits = false"],
    ),
    "no upper limit": (
        [(LIFT, LIFT.replace(' upper="1"', "") + "<!--!-->")],
        "lift.limit.upper",
        ["limits = false"],
    ),
    "no effort": (
        [(LIFT, LIFT.replace(' effort="200"', "") + "<!--!-->")],
        "lift.limit.effort",
        ["limits = false"],
    ),
    "no effort of a continuous one": (
        [('effort="100" velocity="2"/>', 'velocity="2"/><!--!-->')],
        "turn.limit.effort",
        ["nothing"],
    ),
    "zero effort": ([(LIFT, LIFT.replace("200", "0") + "<!--!-->")], "lift.limit.effort", ["> 0"]),
    "negative velocity": (
        [(LIFT, LIFT.replace('"2"', '"-2"') + "<!--!-->")],
        "lift.limit.velocity",
        ["> 0"],
    ),
    "limits exchanged": (
        [(LIFT, LIFT.replace("-1", "2") + "<!--!-->")],
        "lift.limit",
        ["below the upper one"],
    ),
    "Coulomb friction": (
        [('friction="0"/>', 'friction="3"/><!--!-->')],
        "lift.dynamics.friction",
        ["beta", "dynamics = false", "coulomb = 3"],
    ),
    "negative friction": (
        [('friction="0"/>', 'friction="-3"/><!--!-->')],
        "lift.dynamics.friction",
        [">= 0"],
    ),
    "negative damping": (
        [('damping="0.5" friction="0"/>', 'damping="-1"/><!--!-->')],
        "lift.dynamics.damping",
        [">= 0"],
    ),
    "mimic": (
        [(LIFT, LIFT + '<mimic joint="turns"/><!--!-->')],
        "joint.lift.mimic",
        ["turn", "lock = { lift = 0.0 }"],
    ),
    "massless end": (
        [
            (RAM, ""),
            (JAW, ""),
            (
                '<joint name="slide" type="prismatic">',
                '<joint name="slide" type="prismatic"><!--!-->',
            ),
        ],
        "joint.slide",
        ["without moving any mass"],
    ),
    "point on the axis": (
        [
            (RAM, ""),
            (
                JAW,
                (
                    '<inertial><mass value="1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" '
                    'iyz="0" izz="0"/></inertial>'
                ),
            ),
            (
                'type="prismatic">\n    <parent link="boom"/>',
                'type="continuous"><!--!-->\n    <parent link="boom"/>',
            ),
            (
                '<parent link="ram"/>\n    <child link="jaw"/>\n    <axis xyz="0 1 0"/>',
                '<parent link="ram"/>\n    <child link="jaw"/>\n    <axis xyz="1 0 0"/>',
            ),
        ],
        "joint.slide",
        ["the coordinate slide"],
    ),
    "joint with a long name": (
        [
            (
                '<joint name="slide" type="prismatic">',
                f'<joint name="{LONG}" type="prismatic"><!--!-->',
            )
        ],
        f"joint.{LONG}.name",
        ["30", f'[joint.{LONG}] rename = "..."'],
    ),
    "joint with spaces": (
        [
            (
                '<joint name="slide" type="prismatic">',
                '<joint name="my joint" type="prismatic"><!--!-->',
            )
        ],
        'joint."my joint".name',
        ['[joint."my joint"] rename'],
    ),
    "joint with a dash": (
        [('<joint name="slide" type="prismatic">', '<joint name="a-b" type="prismatic"><!--!-->')],
        "joint.a-b.name",
        ["letters, digits"],
    ),
    "C in a name": (
        [
            (
                '<joint name="slide" type="prismatic">',
                '<joint name="x; system(&quot;ls&quot;)" type="prismatic"><!--!-->',
            )
        ],
        ".name",
        ["rename"],
    ),
    "control codes in a name": (
        [
            (
                '<joint name="slide" type="prismatic">',
                f'<joint name="{RLO}" type="prismatic"><!--!-->',
            )
        ],
        ".name",
        ["\\u202e\\x7f"],
    ),
    "link with a slash": (
        [
            ('<link name="ram">', '<link name="/ram"><!--!-->'),
            *[('link="ram"', 'link="/ram"')] * 3,
        ],
        'link."/ram".name',
        ['[link."/ram"] rename'],
    ),
    "link called base": (
        [
            ('<link name="ram">', '<link name="base"><!--!-->'),
            *[('link="ram"', 'link="base"')] * 3,
        ],
        "link.base.name",
        ["base is the ground"],
    ),
    "joint outside the chain": (
        [
            (
                '<link name="tip"/>',
                '<link name="tip"/><link name="x"/><joint name="loose" type='
                '"revolute"><!--!--><parent link="boom"/><child link="x"/></joint>',
            )
        ],
        "joint.loose",
        ["outside the chain", 'drop = ["loose"]', "lock = { loose = 0.0 }"],
    ),
    "floating outside of the chain": (
        [
            (
                '<link name="tip"/>',
                '<link name="tip"/><link name="x"/><joint name="loose" type='
                '"floating"><!--!--><parent link="boom"/><child link="x"/></joint>',
            )
        ],
        "joint.loose",
        ["outside the chain", 'drop = ["loose"]'],
    ),
}

# name: edits of the overlay, end of the key, words; the line is marked by #!
BAD_OVERLAY = {
    "no file": ([('file = "arm.urdf"\n', "")], "urdf.file", ["given nothing"]),
    "missing file": (
        [('file = "arm.urdf"', 'file = "leg.urdf" #!')],
        "urdf.file",
        ["which is not a file"],
    ),
    "folder": ([('file = "arm.urdf"', 'file = "." #!')], "urdf.file", ["which is not a file"]),
    "file with a null": (
        [('file = "arm.urdf"', 'file = "a\\u0000" #!')],
        "urdf.file",
        ["control character"],
    ),
    "file of thousands": (
        [('"arm.urdf"', f'"{"x" * 1900}" #!')],
        "urdf.file",
        ["which is not a file"],
    ),
    "unknown package": (
        [('"arm.urdf"', '"package://no_such_package/arm.urdf" #!')],
        "urdf.file",
        ["ROS_PACKAGE_PATH"],
    ),
    "package without a file": (
        [('"arm.urdf"', '"package://arm" #!')],
        "urdf.file",
        ["ROS_PACKAGE_PATH"],
    ),
    "way out of a package": (
        [('"arm.urdf"', '"package://x/../arm.urdf" #!')],
        "urdf.file",
        ["ROS_PACKAGE_PATH"],
    ),
    "not a table": (
        [("[urdf]\n", "[urdfs]\n"), ('name = "arm"\n', 'name = "arm"\nurdf = 3 #!\n')],
        "urdf",
        ["a table"],
    ),
    "unknown key of urdf": (
        [('base = "world"', 'root = "world" #!')],
        "urdf.root",
        ["unknown key"],
    ),
    "no base": ([('base = "world"\n', "")], "urdf.base", ["given nothing"]),
    "unknown base": ([('"world"', '"word" #!')], "urdf.base", ['"world" (there are:', "arm.urdf"]),
    "unknown tip": ([('tip = "tip"', 'tip = "tool0" #!')], "urdf.tip", ["one of"]),
    "tip is a number": ([('tip = "tip"', "tip = 3 #!")], "urdf.tip", ["a string"]),
    "tip before the base": (
        [('base = "world"\ntip = "tip"', 'base = "boom"\ntip = "column"')],
        "link.column",
        ["which is not behind", "behind the base"],
    ),
    "base is the tip": ([('tip = "tip"', 'tip = "world"')], "link.world", ["no moving joint"]),
    "nothing moves": ([('tip = "tip"', 'tip = "foot"')], "link.foot", ["no moving joint"]),
    "unlocked finger": (
        [(FINGER, "")],
        "joint.finger",
        ["prismatic joint outside the chain", "lock = { finger = 0.0 }"],
    ),
    "unknown lock": ([(FINGER, 'lock = ["fingr"] #!\n')], "urdf.lock", ['"finger" (there are:']),
    "lock of what is fixed": (
        [(FINGER, "lock = { end = 0.0, finger = 0.0 } #!\n")],
        "urdf.lock",
        ['instead of "end"'],
    ),
    "lock at a text": (
        [(FINGER, 'lock = { finger = "open" } #!\n')],
        "urdf.lock.finger",
        ["a number"],
    ),
    "lock is a number": ([(FINGER, "lock = 3 #!\n")], "urdf.lock", ["a name or a list"]),
    "unknown drop": ([(FINGER, 'drop = ["finer"] #!\n')], "urdf.drop", ['"finger" (there are:']),
    "drop of the chain": (
        [(FINGER, FINGER + 'drop = ["slide"] #!\n')],
        "urdf.drop",
        ["outside the chain"],
    ),
    "limits is a number": (
        [(FINGER, FINGER + "limits = 0 #!\n")],
        "urdf.limits",
        ["true or false"],
    ),
    "gear at a fixed joint": (
        [
            (
                "[joint.turn]",
                '[joint.end]\ngear = { type = "rigid" } #!\nafter = [{ name = "x", type = '
                '"rotation", axis = [1, 0, 0], spring = { type = "linear", stiffness = 1.0 } }]\n'
                "[joint.turn]",
            )
        ],
        "joint.end.gear",
        ["an unknown key", "one of after, before"],
    ),
    "unknown joint": (
        [("[joint.turn]", "[joint.trn] #!")],
        "joint.trn",
        ["unknown joint", '"turn" (there are:'],
    ),
    "joint that is fixed": ([("[joint.turn]", "[joint.end] #!")], "joint.end", ["does not move"]),
    "joint that is locked": (
        [("[joint.turn]", "[joint.finger] #!")],
        "joint.finger",
        ["a moving joint of the chain"],
    ),
    "joint is a number": (
        [("[joint.turn]\n", "[joint]\nturn = 3 #!\n[joint.x]\n")],
        "joint.turn",
        ["a table"],
    ),
    "joints are a number": (
        [
            ("[joint.turn]\n", ""),
            ("[joint.lift]", "[joints.lift]"),
            ("[[joint.lift", "[[joints.lift"),
            ("motor = { ratio = 50.0, inertia = 1e-3 }", ""),
            ('name = "arm"\n', 'name = "arm"\njoint = 3 #!\n'),
        ],
        "joint",
        ["a table"],
    ),
    "unknown key of a joint": (
        [
            ("motor = { ratio = 50.0", "moter = { ratio = 50.0"),
            ("[joint.turn]\n", "[joint.turn] \n"),
        ],
        "joint.turn.moter",
        ["motor"],
    ),
    "unknown link": ([("[link.boom]", "[link.bom] #!")], "link.bom", ['"boom" (there are:']),
    "name for a link that is fixed": (
        [("[link.boom]\n", "[link.foot]\n"), ('"arm2"', '"arm2" #!')],
        "link.foot.rename",
        ["fixed to another one"],
    ),
    "bad new name": ([('"arm2"', '"arm 2" #!')], "link.boom.rename", ["letters, digits"]),
    "new name that is taken": ([('"arm2"', '"column" #!')], "name", ["not taken"]),
    "new name of a joint that is taken": (
        [('rename = "q2"', 'rename = "turn" #!')],
        "name",
        ["not taken"],
    ),
    "body of nothing": (
        [('rename = "arm2"', "body = { mass = -1.0 } #!")],
        "link.boom.body.mass",
        [">= 0"],
    ),
    "motor in addition to a spring": (
        [
            ("[joint.turn]\n", '[joint.turn]\nspring = { type = "linear", stiffness = 1.0 }\n'),
            ("ratio = 50.0, inertia = 1e-3 }", "ratio = 50.0, inertia = 1e-3 } #!"),
        ],
        "joint.turn.motor",
        ["either a motor or a spring"],
    ),
    "spring in addition to a gear": (
        [
            (
                "[joint.turn]\nmotor = { ratio = 50.0, inertia = 1e-3 }",
                (
                    "[joint.turn]\n"
                    'gear = { type = "rigid" }\n'
                    'spring = { type = "linear", stiffness = 1.0 } #!'
                ),
            )
        ],
        "dof.turn.spring",
        ["either a gear"],
    ),
    "elastic gear without a motor": (
        [("motor = { ratio = -80.0, inertia = 1e-3, friction = { viscous = 1e-3 } }\n", "")],
        "joint.lift.motor",
        ["together with an elastic gear"],
    ),
    "elastic gear without a rotor": (
        [
            ("ratio = -80.0, inertia = 1e-3", "ratio = -80.0"),
            ("viscous = 1e-3 } }", "viscous = 1e-3 } } #!"),
        ],
        "joint.lift.motor.inertia",
        ["elastic gear"],
    ),
    "elastic gear, rotor of zero": (
        [
            ("-80.0, inertia = 1e-3", "-80.0, inertia = 0.0"),
            ("viscous = 1e-3 } }", "viscous = 1e-3 } } #!"),
        ],
        "motor.m2.inertia",
        ["> 0", "elastic"],
    ),
    "ratio of zero": (
        [("ratio = 50.0, inertia = 1e-3 }", "ratio = 0.0, inertia = 1e-3 } #!")],
        "motor.m1.ratio",
        ["not 0"],
    ),
    "ratio is a text": (
        [("ratio = 50.0, inertia = 1e-3 }", 'ratio = "50", inertia = 1e-3 } #!')],
        "motor.m1.ratio",
        ["a number"],
    ),
    "motor that drives": (
        [("ratio = 50.0, inertia = 1e-3 }", 'ratio = 50.0, inertia = 1e-3, drives = "lift" } #!')],
        "motor.drives",
        ["drives turn"],
    ),
    "two motors": (
        [
            (
                "[variant",
                '[[motor]]\nname = "mm"\ndrives = "turn"\nratio = 1\ninertia = 1.0\n[variant',
            ),
            ("ratio = 50.0, inertia = 1e-3 }", "ratio = 50.0, inertia = 1e-3 } #!"),
        ],
        "joint.turn.motor",
        ["either motor or a [[motor]] table"],
    ),
    "motor list is a text": (
        [('name = "arm"\n', 'name = "arm"\nmotor = "x" #!\n')],
        "motor",
        ["list of tables"],
    ),
    "extra without a spring": (
        [('spring = { type = "linear", stiffness = 2e4 }\n', "")],
        "dof.bend.gear",
        ["spring"],
    ),
    "extra with a taken name": ([('name = "bend"', 'name = "q2" #!')], "name", ["not taken"]),
    "extras in no list": (
        [("[[joint.lift.after]]", "[joint.lift.after] #!")],
        "joint.lift.after",
        ["list of tables"],
    ),
    "home outside of the limits": (
        [("home_rad = [0.1, 0.2, 0.3]", "home_rad = [0.1, 0.2, 0.05] #!")],
        "home_rad",
        ["slide within its limits 0.1..0.5"],
    ),
    "home of four": (
        [("home_rad = [0.1, 0.2, 0.3]", "home_rad = [0.1, 0.2, 0.3, 0] #!")],
        "home_rad",
        ["3 number"],
    ),
    "unknown key": ([('name = "arm"\n', 'name = "arm"\ngrvity = 3 #!\n')], "grvity", ["gravity"]),
    "variant into nothing": (
        [('"element.arm2.dof', '"element.boom.dof')],
        'boom.dof.q2.gear"',
        ["arm2"],
    ),
}
