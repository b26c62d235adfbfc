"""Function blocks as structured text of IEC 61131-3 and as XML of PLCopen TC6 2.01."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from flexgen.base.version import __version__
from flexgen.codegen.build.template_files import xml_text
from flexgen.exports.c_code.plcopen.blocks import Block, Variable

_XML_SECTIONS = {"VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR": "localVars"}
DATE = "2000-01-01T00:00:00"  # of every file: the same model gives the same bytes


def structured_text(blocks: Sequence[Block]) -> str:
    """The declarations in ST."""
    return "\n".join(_block(block) for block in blocks)


def _block(block: Block) -> str:
    """A function block in Structured Text: variables by sections, and its body."""
    text = f"{_comment(block.doc + ' Written by flexgen.', '')}FUNCTION_BLOCK {block.name}\n"
    for keyword, variables in block.sections:
        text += f"{keyword}\n"
        for v in variables:
            text += _comment(v.doc, "    ") + f"    {v.name} : {_type(v)};\n"
        text += "END_VAR\n"
    return f"{text}{_comment(_body(block), '')}END_FUNCTION_BLOCK\n"


def _type(v: Variable) -> str:
    return f"ARRAY [0..{v.size - 1}] OF {v.type}" if v.size else v.type


def _body(block: Block) -> str:
    return (
        f"The body is the function {block.name.lower()}_call in C: it takes the address of the "
        "instance."
    )


def _comment(text: str, indent: str) -> str:
    """A comment; whatever could end or nest one is taken apart."""
    clean = "".join(c if c.isascii() and c.isprintable() else " " for c in text)
    clean = clean.replace("*)", "* )").replace("(*", "( *").replace("$", "S")
    lines = textwrap.wrap(clean, 110, break_on_hyphens=False)
    return "".join(
        f"{indent}{'(* ' if k == 0 else '   '}{line}" + (" *)\n" if k == len(lines) - 1 else "\n")
        for k, line in enumerate(lines)
    )


def xml(name: str, blocks: Sequence[Block]) -> str:
    """A project of PLCopen TC6 2.01 with the function blocks."""
    pous = "".join(_pou(block) for block in blocks)
    scaling = "".join(
        f'      <{kind}><scaling x="1" y="1"/></{kind}>\n' for kind in ("fbd", "ld", "sfc")
    )
    return f"""\
<?xml version="1.0" encoding="utf-8"?>
<project xmlns="http://www.plcopen.org/xml/tc6_0201" xmlns:xhtml="http://www.w3.org/1999/xhtml">
  <fileHeader companyName="" productName="flexgen" productVersion="{xml_text(__version__)}" \
creationDateTime="{DATE}"/>
  <contentHeader name="{xml_text(name)}">
    <coordinateInfo>
{scaling}    </coordinateInfo>
  </contentHeader>
  <types>
    <dataTypes/>
    <pous>
{pous}    </pous>
  </types>
  <instances>
    <configurations/>
  </instances>
</project>
"""


def _pou(block: Block) -> str:
    """A function block as an element of PLCopen XML."""
    sections = "".join(_section(keyword, variables) for keyword, variables in block.sections)
    body = _comment(_body(block), "").rstrip("\n")
    return f"""\
      <pou name="{xml_text(block.name)}" pouType="functionBlock">
        <interface>
{sections}        </interface>
        <body>
          <ST>
            <xhtml:p>{xml_text(body)}</xhtml:p>
          </ST>
        </body>
        <documentation>
          <xhtml:p>{xml_text(block.doc)}</xhtml:p>
        </documentation>
      </pou>
"""


def _section(keyword: str, variables: Sequence[Variable]) -> str:
    """The variables of a section, ``keyword`` of Structured Text, as an element of PLCopen XML."""
    kind = _XML_SECTIONS[keyword]
    text = f"          <{kind}>\n"
    for v in variables:
        array = (
            '<array><dimension lower="0" '
            f'upper="{v.size - 1}"/><baseType><{v.type}/></baseType></array>'
        )
        text += f"""\
            <variable name="{xml_text(v.name)}">
              <type>{array if v.size else f"<{v.type}/>"}</type>
              <documentation><xhtml:p>{xml_text(v.doc)}</xhtml:p></documentation>
            </variable>
"""
    return f"{text}          </{kind}>\n"
