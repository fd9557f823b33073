"""`modelDescription.xml` of FMI 2.0 and 3.0, and what FMI 3.0 has beside it: build description, terminals and icon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from valvesim.export.fmi_variables import FmiVariable, unit_definitions

MOST_INPUT_ORDER, MOST_OUTPUT_ORDER = 3, 1  # derivatives over time that co-simulation takes and gives

TERMINALS: dict[str, tuple[str, dict[str, str], tuple[float, float]]] = {
    "supply": ("hydraulic supply P", {"pressure": "supply_pressure", "leakage": "internal_leakage"}, (-10.0, -100.0)),
    "tank": ("hydraulic return R of the pilot stage", {"pressure": "return_pressure"}, (10.0, -100.0)),
    "load": (
        "load between ports A and B",
        {"pressure": "load_pressure", "flow": "load_flow"},
        (0.0, 100.0),
    ),
    "coil": ("electrical connection of the coils", {"command": "{command}"}, (-92.0, 0.0)),
    "oil": ("temperature of the oil that comes in", {"temperature": "oil_temperature"}, (92.0, 0.0)),
}
"""Terminals: doc, members with the variable of each, place on the icon (of -100 to 100 each way)."""


@dataclass(frozen=True, kw_only=True)
class ModelHead:
    """What a description says of the model as a whole."""

    identifier: str
    name: str
    token: str
    description: str
    version: str
    generated_by: str
    generated_at: str
    stop: float
    step: float
    tolerance: float


def fmi2_description(head: ModelHead, variables: Sequence[FmiVariable], sources: Sequence[str]) -> bytes:
    """modelDescription.xml of FMI 2.0, model exchange and co-simulation."""
    root = Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=head.name, guid=head.token, description=head.description,
        version=head.version, generationTool=head.generated_by, generationDateAndTime=head.generated_at,
        variableNamingConvention="structured", numberOfEventIndicators="0",
    )  # fmt: skip
    shared = dict(
        modelIdentifier=head.identifier, canGetAndSetFMUstate="true", canSerializeFMUstate="true",
        providesDirectionalDerivative="true", canNotUseMemoryManagementFunctions="true",
    )  # fmt: skip
    exchange = SubElement(root, "ModelExchange", shared)
    step = SubElement(
        root, "CoSimulation", shared, canHandleVariableCommunicationStepSize="true", canInterpolateInputs="true",
        maxOutputDerivativeOrder=str(MOST_OUTPUT_ORDER),
    )  # fmt: skip
    for kind in (exchange, step):
        files = SubElement(kind, "SourceFiles")
        for name in sources:
            SubElement(files, "File", name=name)
    _units(root, variables)
    _categories(root)
    _experiment(root, head)
    listed = SubElement(root, "ModelVariables")
    place = {one.reference: k for k, one in enumerate(variables, start=1)}
    for one in variables:
        about = {"name": one.name, "valueReference": str(one.reference), "causality": one.causality}
        about |= {"variability": one.variability, "description": one.doc}
        about |= {"initial": one.initial} if one.initial and one.causality != "input" else {}
        entry = SubElement(listed, "ScalarVariable", about)
        real = _numbers(one)
        if one.derivative_of is not None:
            real["derivative"] = str(place[one.derivative_of])
        SubElement(entry, "Real", real)
    structure = SubElement(root, "ModelStructure")
    titles = {"Output": "Outputs", "ContinuousStateDerivative": "Derivatives", "InitialUnknown": "InitialUnknowns"}
    for section, chosen in _structure(variables).items():
        part = SubElement(structure, titles[section])
        for one in chosen:
            unknown = SubElement(part, "Unknown", index=str(place[one.reference]))
            if section != "InitialUnknown" and one.dependencies is not None:
                unknown.set("dependencies", " ".join(str(place[reference]) for reference in one.dependencies))
    return _text(root)


def fmi3_description(head: ModelHead, variables: Sequence[FmiVariable]) -> bytes:
    """modelDescription.xml of FMI 3.0, model exchange and co-simulation."""
    root = Element(
        "fmiModelDescription", fmiVersion="3.0", modelName=head.name, instantiationToken=head.token,
        description=head.description, version=head.version, generationTool=head.generated_by,
        generationDateAndTime=head.generated_at, variableNamingConvention="structured",
    )  # fmt: skip
    shared = dict(
        modelIdentifier=head.identifier, canGetAndSetFMUState="true", canSerializeFMUState="true",
        providesDirectionalDerivatives="true", providesAdjointDerivatives="true",
    )  # fmt: skip
    SubElement(root, "ModelExchange", shared)
    SubElement(
        root, "CoSimulation", shared, canHandleVariableCommunicationStepSize="true", providesIntermediateUpdate="true",
        mightReturnEarlyFromDoStep="true", canReturnEarlyAfterIntermediateUpdate="true",
        maxOutputDerivativeOrder=str(MOST_OUTPUT_ORDER), recommendedIntermediateInputSmoothness="0",
    )  # fmt: skip
    _units(root, variables)
    _categories(root)
    _experiment(root, head)
    listed = SubElement(root, "ModelVariables")
    for one in variables:
        about = {"name": one.name, "valueReference": str(one.reference), "causality": one.causality}
        about |= {"variability": one.variability, "description": one.doc}
        about |= {"initial": one.initial} if one.initial and one.causality != "input" else {}
        about |= {"intermediateUpdate": "true"} if one.causality in ("input", "output") else {}
        about |= _numbers(one)
        if one.derivative_of is not None:
            about["derivative"] = str(one.derivative_of)
        SubElement(listed, "Float64", about)
    structure = SubElement(root, "ModelStructure")
    for section, chosen in _structure(variables).items():
        for one in chosen:
            unknown = SubElement(structure, section, valueReference=str(one.reference))
            if section != "InitialUnknown" and one.dependencies is not None:
                unknown.set("dependencies", " ".join(map(str, one.dependencies)))
    return _text(root)


def build_description(head: ModelHead, sources: Sequence[str]) -> bytes:
    """sources/buildDescription.xml of FMI 3.0: what a compiler needs to be told."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=head.identifier)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    SubElement(configuration, "Library", name="m", external="true")
    return _text(root)


def terminals(variables: Sequence[FmiVariable], command: str) -> bytes:
    """terminalsAndIcons/terminalsAndIcons.xml of FMI 3.0: ports of the valve, and where they stand on the icon."""
    root = Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    picture = SubElement(root, "GraphicalRepresentation")
    square = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    SubElement(picture, "CoordinateSystem", square, suggestedScalingFactorTo_mm="0.1")
    SubElement(picture, "Icon", square)
    listed = SubElement(root, "Terminals")
    known = {one.name for one in variables}
    for name, (doc, members, (x, y)) in TERMINALS.items():
        terminal = SubElement(listed, "Terminal", name=name, matchingRule="bus", description=doc)
        for member, variable in members.items():
            variable = variable.format(command=command)
            if variable in known:
                SubElement(
                    terminal, "TerminalMemberVariable", variableName=variable, memberName=member, variableKind="signal"
                )  # fmt: skip
        SubElement(
            terminal, "TerminalGraphicalRepresentation", x1=f"{x - 8:g}", y1=f"{y - 8:g}", x2=f"{x + 8:g}",
            y2=f"{y + 8:g}", defaultConnectionColor="0 0 0", iconBaseName="terminal",
        )  # fmt: skip
    return _text(root)


def _structure(variables: Sequence[FmiVariable]) -> dict[str, list[FmiVariable]]:
    """Entries of the model structure by kind, in the order of the schema."""
    outputs = [one for one in variables if one.causality == "output"]
    rates = [one for one in variables if one.derivative_of is not None]
    worked_out = [one for one in (*outputs, *rates) if one.initial == "calculated"]
    return {"Output": outputs, "ContinuousStateDerivative": rates, "InitialUnknown": worked_out}


def _numbers(one: FmiVariable) -> dict[str, str]:
    about = {"unit": one.unit}
    if one.display_unit is not None:
        about["displayUnit"] = one.display_unit
    figures = {"min": one.low, "max": one.high, "nominal": one.nominal, "start": one.start}
    return about | {name: repr(float(value)) for name, value in figures.items() if value is not None}


def _units(root: Element, variables: Sequence[FmiVariable]) -> None:
    definitions = SubElement(root, "UnitDefinitions")
    for about in unit_definitions(variables):
        unit = SubElement(definitions, "Unit", name=about["name"])
        SubElement(unit, "BaseUnit", {name: _power(name, value) for name, value in about["base"].items()})
        for display in about["displays"]:
            SubElement(unit, "DisplayUnit", name=display["name"], factor=repr(display["factor"]))


def _power(name: str, value: float) -> str:
    return repr(float(value)) if name in ("factor", "offset") else str(round(value))


def _categories(root: Element) -> None:
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", name="logStatusError", description="why a call failed")
    SubElement(categories, "Category", name="logStatusDiscard", description="why a result was discarded")


def _experiment(root: Element, head: ModelHead) -> None:
    SubElement(
        root, "DefaultExperiment", startTime="0.0", stopTime=repr(head.stop), tolerance=repr(head.tolerance),
        stepSize=repr(head.step),
    )  # fmt: skip


def _text(root: Any) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
