"""Small MJCF files: one bar and one string, and features that a scene cannot have."""

from __future__ import annotations

FREE = '<joint type="free"/>'
BALL = '<joint type="ball"/>'
INERTIAL = FREE + '<inertial pos="0.5 0 0" mass="1" diaginertia="{}"/>'
ROD = '<geom type="capsule" size="0.01" fromto="0 0 0 1 0 0"/>'
SITES = '<site name="a"/><site name="b" pos="1 0 0"/>'
STRING = '<spatial stiffness="1"><site site="a"/><site site="w"/></spatial>'


def file(
    body: str = FREE + ROD + SITES, tendon: str = STRING, more: str = "", world: str = ""
) -> str:
    """Write a file of one bar and one string, each line an element of its own."""
    inside = f'<worldbody>\n<site name="w" pos="0 1 0"/>{world}\n<body name="bar">{body}</body>\n</worldbody>\n<tendon>{tendon}</tendon>\n{more}\n'
    return f"<mujoco>\n{inside}</mujoco>"


REFUSED: dict[str, tuple[str, str]] = {
    "include elsewhere": (file(more='<include file="/etc/passwd"/>'), "line 7, <include> file: is '/etc/passwd': give a file in "),
    "include nothing": (file(more='<include file="no.xml"/>'), "line 7, <include> file: is 'no.xml': there is no such file"),
    "include itself": (file(more='<include file="scene.xml"/>'), "which does not include itself"),
    "hinge that slides": (file('<joint type="slide"/><joint/>' + ROD + SITES), r"line 4, <joint> type: is a hinge.* ball"),
    "damped joint": (file('<joint type="ball" damping="0.1"/>' + ROD + SITES), r"<joint> damping: is '0.1', which has no counterpart"),
    "limits": (file('<joint type="ball" range="0 1"/>' + ROD + SITES), "<joint> range: limits a joint"),
    "two joints": (file(FREE + FREE + ROD + SITES), "<joint>: follows a joint"),
    "free inside": (file(FREE + ROD + SITES + f"<body>{FREE}{ROD}</body>"), "is free inside another body"),
    "slides without turning": (file('<joint type="slide"/>' + ROD + SITES), 'line 4, <body name="bar">: is a bar that slides without turning'),
    "slide along nothing": (file('<joint type="slide" axis="0 0 0"/>' + ROD + SITES), "<joint> axis: slides in another body, or along no direction"),
    "slides that depend": (file('<joint type="slide"/>' * 2 + '<joint type="ball"/>' + ROD + SITES), "slides along directions that depend"),
    "kind of joint": (file('<joint type="screw"/>' + ROD + SITES), "is 'screw': tenscasadi reads hinge or slide"),
    "third place": (file(FREE + ROD + SITES + '<site name="c" pos="0.5 0 0"/>', STRING + STRING.replace('"a"', '"b"') + STRING.replace('"a"', '"c"')),
                    'line 4, <body name="bar">: has strings or joints at 3 places'),
    "beside the end": (file(FREE + ROD + '<site name="a" pos="0.5 0 0"/>'), "bars have them at their ends"),
    "no mass": (file(FREE + '<geom type="capsule" size="0.01" fromto="0 0 0 1 0 0" mass="0"/>' + SITES, STRING + STRING.replace('"a"', '"b"')),
                "has no mass between its ends"),
    "nothing": (file(FREE, ""), "has no mass: give an <inertial> or a geom"),
    "mass beside the middle": (file(INERTIAL.format("1 1 1").replace("0.5", "0.3") + ROD + SITES), "which is not the middle of its ends"),
    "light in the middle": (file(INERTIAL.format("1e-3 1e-3 1e-3") + ROD + SITES), "less than a thin rod"),
    "not round": (file(INERTIAL.format("0.1 0.1 0.2") + ROD + SITES), "bars are round"),
    "mesh": (file(FREE + '<geom type="mesh" mesh="m"/>' + SITES), "<geom> type: is 'mesh', whose mass is not read"),
    "sphere fromto": (file(FREE + ROD.replace("capsule", "sphere") + SITES), "<geom> fromto: is given to a sphere"),
    "size": (file(FREE + ROD.replace("0.01", "-1") + SITES), "<geom> size: is '-1': give lengths greater than 0"),
    "number": (file(FREE + ROD.replace("0.01", "thin") + SITES), "<geom> size: is 'thin': give 1 or 2 or 3 finite numbers"),
    "infinite": (file(FREE + ROD.replace("1 0 0", "1 0 inf") + SITES), "<geom> fromto: is '0 0 0 1 0 inf': give 6 finite numbers"),
    "two turns": (file(FREE + ROD + SITES).replace('name="bar"', 'quat="1 0 0 0" euler="0 0 0"'), "<body> euler: is given beside quat"),
    "no turn": (file(FREE + ROD + SITES).replace('name="bar"', 'quat="0 0 0 0"'), "<body> quat: is '0 0 0 0': give directions of some length"),
    "mocap": (file(FREE + ROD + SITES).replace('name="bar"', 'mocap="true"'), "<body> mocap: is moved from outside"),
    "class": (file(FREE + ROD.replace("type", 'class="thin" type') + SITES), "names the class 'thin'"),
    "same site": (file(FREE + ROD + SITES * 2), '<site name="a"> name: is the name of two sites'),
    "wrapping": (file(tendon='<spatial><site site="a"/><geom geom="g"/><site site="w"/></spatial>'), "<geom>: has no counterpart in a scene: .*wrap"),
    "one site": (file(tendon=STRING.replace('<site site="w"/>', "")), "runs through 1 sites"),
    "no site": (file(tendon=STRING.replace('"w"', '"v"')), "<site> site: is 'v', which is no site"),
    "fixed tendon": (file(tendon='<fixed><joint joint="j" coef="1"/></fixed>'), "<fixed>: has no counterpart"),
    "limited tendon": (file(tendon=STRING.replace("<spatial", '<spatial range="0 1"')), "<spatial> range: limits the length"),
    "friction": (file(tendon=STRING.replace("<spatial", '<spatial frictionloss="0.5"')), "<spatial> frictionloss: is '0.5'"),
    "deadband": (file(tendon=STRING.replace("<spatial", '<spatial springlength="0.5 1"')), "<spatial> springlength: is '0.5 1': give one length"),
    "no length": (file(tendon=STRING.replace("<spatial", '<spatial springlength="0"')), "<spatial> springlength: is 0"),
    "polynomial": (file(tendon=STRING.replace('"1"', '"1 2"')), "<spatial> stiffness: is '1 2', a polynomial"),
    "weld of hanging bodies": (file(BALL + ROD + SITES, world=f'<body name="other" pos="0 0 1">{BALL + ROD}</body>',
                                    more='<equality><weld body1="bar" body2="other"/></equality>'),
                     "line 7, <weld>: fixes two bodies that both hang"),
    "connect to nothing": (file(more='<equality><connect body1="b" anchor="0 0 0"/></equality>'), "<connect> body1: is 'b', which is no body"),
    "connect without anchor": (file(more='<equality><connect body1="bar"/></equality>'), "<connect> anchor: is not given: give 3 numbers"),
    "sites apart": (file(more='<equality><connect site1="a" site2="w"/></equality>'), "<connect>: joins sites that are apart"),
    "motor": (file(more='<actuator><motor tendon="t"/></actuator>'), "<motor> tendon: is 't'"),
    "motor of a tendon": (file(tendon=STRING.replace("<spatial", '<spatial name="t" springlength="0 1"'),
                  more='<actuator><motor tendon="t"/></actuator>'),
                          "<motor>: adds a force to a string that goes slack"),
    "activation": (file(tendon=STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                        more='<actuator><general tendon="t" dyntype="filter"/></actuator>'),
                   "<general> dyntype: is 'filter'"),
    "actuator of nothing": (file(more='<actuator><position tendon="t"/></actuator>'), "<position> tendon: is 't'"),
    "gain": (file(tendon=STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                  more='<actuator><general tendon="t" biastype="affine" biasprm="0 0 -1"/></actuator>'),
             "<general> gainprm: pulls by another law"),
    "tension limits": (file(tendon=STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                            more='<actuator><position tendon="t" forcerange="-5 0"/></actuator>'), "<position> forcerange: is '-5 0'"),
    "two laws": (file(tendon=STRING.replace("<spatial", '<spatial name="t" springlength="0 1"'),
                      more='<actuator><position tendon="t"/></actuator>'),
                 "stiffness: has stiffness or damping beside an actuator"),
    "some driven": (file(tendon=STRING + STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                         more='<actuator><position tendon="t"/></actuator>'), "<spatial>: has no actuator, while others have"),
    "short ctrl": (file(tendon=STRING.replace('<spatial stiffness="1"', '<spatial name="t"'),
                        more='<actuator><position tendon="t"/></actuator><keyframe><key ctrl="1 2"/></keyframe>'),
                   "<key> ctrl: is '1 2': give 1 finite number"),
    "wind": (file(more='<option wind="1 0 0"/>'), "<option> wind: is '1 0 0'"),
    "coordinates": (file(more='<compiler coordinate="polar"/>'), "coordinate: is 'polar': tenscasadi reads local or global"),
    "total mass": (file(more='<compiler settotalmass="3"/>'), "<compiler> settotalmass: is '3'"),
    "gravity": (file(more='<option gravity="0 0"/>'), "gravity: is '0 0': give 3 finite numbers"),
    "obstacle": (file(world='<geom type="box" size="1 1 1"/>'), r"<geom> type: is touched by bodies: tenscasadi's grounds are planes"),
    "composite": (file(world='<composite type="cable"/>'), "<composite>: has no counterpart"),
    "plugin": (file(more="<extension><plugin/></extension>"), "<extension>: has no counterpart"),
    "negative": (file(tendon=STRING.replace('"1"', '"-1"')), "stiffness of string 0 is -1"),
    "urdf": ("<robot/>", "<robot>: is no MJCF"),
    "no world": ("<mujoco/>", "<mujoco>: has no <worldbody>"),
    "empty": ("", "it is no XML"),
    "text": ("structure = 3", "line 1: it is no XML"),
    "unfinished": (file()[:-5], "line 8: it is no XML"),
    "twice": (file(FREE + '<geom size="1" size="2"/>'), "line 4: it is no XML, duplicate attribute"),
    "encoding": ('<?xml version="1.0" encoding="klingon"?><mujoco/>', "encoding"),
}  # fmt: skip
