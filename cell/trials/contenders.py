"""What is compared: a policy table by name or file, and the belief it goes by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cell.decision.belief import NAMES as BELIEFS
from cell.decision.policy import load, shipped
from cell.errors import ConfigError, one_of

SHORT = {
    "tb": "tb-decairl",
    "dec": "dec-airl",
    "always-industrial-when-permitted": "always-industrial",
}
"""Short and long names of shipped policies; every mode change goes through the permit."""
ORACLE = "oracle"
"""The belief that is the truth; and TB-DecAIRL's policy with it."""
_WEIGHTS = ".safetensors"


@dataclass(frozen=True)
class Contender:
    """One policy in a campaign.

    Attributes:
        name: as given, for tables. policy: name of a shipped one, or of the file. csv: the table's text.
        belief: as in the configuration, "oracle", or empty: the configured one.
    """

    name: str
    policy: str
    csv: str
    belief: str = ""


def contender(name: str, perception: str) -> Contender:
    """The contender called `name`: POLICY, POLICY@BELIEF, or "oracle".

    Args:
        name: POLICY is tb, dec, a shipped policy or a CSV file; BELIEF one of none, last-gesture, gru,
            oracle, or a file of weights. perception: "full" or "truth".

    Raises:
        CellError: unknown, unreadable, or an oracle where nobody tells the truth.
    """
    table, _, belief = name.rpartition("@")
    if not table or not (belief in (*BELIEFS, ORACLE) or belief.endswith(_WEIGHTS)):
        if table and not Path(name).is_file():
            raise ConfigError(f"--policies {name}: {one_of(belief, [*BELIEFS, ORACLE, f'FILE{_WEIGHTS}'])}")
        table, belief = name, ""
    if table == ORACLE:
        table, belief = "tb", ORACLE
    if belief == ORACLE and perception != "truth":
        raise ConfigError(f"--policies {name}: an oracle needs --perception truth")
    if belief.endswith(_WEIGHTS):
        belief = str(Path(belief).resolve())
    table = SHORT.get(table, table)
    policy = load(table)  # raises for a table that is missing or incomplete, before anything runs
    return Contender(name, policy.name, shipped().get(table, Path(table)).read_text(), belief)
