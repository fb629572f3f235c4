"""A minimal PEtab problem, A -> B with rate constant k, whose files tests modify."""

from __future__ import annotations

import textwrap

MODEL = """\
<?xml version="1.0" encoding="UTF-8"?>
<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1">
  <model id="decay">
    <listOfCompartments>
      <compartment id="vessel" size="1" constant="true"/>
    </listOfCompartments>
    <listOfSpecies>
      <species id="A" compartment="vessel" initialConcentration="2" hasOnlySubstanceUnits="false"
        boundaryCondition="false" constant="false"/>
      <species id="B" compartment="vessel" initialConcentration="0" hasOnlySubstanceUnits="false"
        boundaryCondition="false" constant="false"/>
    </listOfSpecies>
    <listOfParameters>
      <parameter id="k" value="1" constant="true"/>
      <parameter id="back" value="0" constant="true"/>
    </listOfParameters>
    <listOfReactions>
      <reaction id="forth" reversible="false" fast="false">
        <listOfReactants>
          <speciesReference species="A" stoichiometry="1" constant="true"/>
        </listOfReactants>
        <listOfProducts>
          <speciesReference species="B" stoichiometry="1" constant="true"/>
        </listOfProducts>
        <kineticLaw>
          <math xmlns="http://www.w3.org/1998/Math/MathML">
            <apply><times/><ci>vessel</ci>
              <apply><minus/>
                <apply><times/><ci>k</ci><ci>A</ci></apply>
                <apply><times/><ci>back</ci><ci>B</ci></apply>
              </apply>
            </apply>
          </math>
        </kineticLaw>
      </reaction>
    </listOfReactions>
  </model>
</sbml>
"""

YAML = """\
format_version: 1
parameter_file: parameters.tsv
problems:
- condition_files: [conditions.tsv]
  measurement_files: [measurements.tsv]
  observable_files: [observables.tsv]
  sbml_files: [model.xml]
"""

PARAMETERS = """\
parameterId parameterScale lowerBound upperBound nominalValue estimate
k log10 0.01 100 0.5 1
gain lin 0.1 10 3 1
sigma log 0.001 10 0.2 1
"""

CONDITIONS = """\
conditionId A
few 1
many 4
"""

OBSERVABLES = """\
observableId observableFormula noiseFormula
seen observableParameter1_seen*A noiseParameter1_seen
"""

MEASUREMENTS = """\
observableId simulationConditionId time measurement observableParameters noiseParameters
seen few 1 1.7 gain sigma
seen few 2 1.2 gain sigma
seen few 4 0.7 gain sigma
seen many 1 7.1 gain 0.5
seen many 3 2.6 2.5 0.5
"""


def write_problem(folder, **changed):
    """Write the problem with some files replaced, and return the path of its YAML file.

    In tables a space stands for a tab, and ``_`` for an empty cell.
    """
    tables = {
        "parameters": PARAMETERS,
        "conditions": CONDITIONS,
        "observables": OBSERVABLES,
        "measurements": MEASUREMENTS,
    }
    for name, text in tables.items():
        text = textwrap.dedent(changed.get(name, text))
        lines = [
            ["" if cell == "_" else cell for cell in row.split(" ")] for row in text.splitlines()
        ]
        (folder / f"{name}.tsv").write_text("".join("\t".join(row) + "\n" for row in lines))
    (folder / "model.xml").write_text(changed.get("model", MODEL))
    (folder / "problem.yaml").write_text(changed.get("yaml", YAML))
    return folder / "problem.yaml"
