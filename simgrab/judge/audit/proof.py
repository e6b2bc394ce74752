"""Results of an audit: proofs, each passed, failed with its findings, or not made."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Finding:
    """One thing that is not true."""

    where: str  # frame and column (`frame 12, gamma_deg`), file, or manifest field
    what: str  # the value found, and the expected value

    def __str__(self) -> str:
        return f"{self.where}: {self.what}"


@dataclass(frozen=True)
class Proof:
    """One claim about a dataset and whether it holds."""

    claim: str
    checked: int  # number of comparisons; 0 without findings means that the proof was not made
    findings: tuple[Finding, ...] = ()  # empty when the claim holds
    note: str = ""  # why the proof was not made, or with what margin it holds
    renderer: str = ""  # the second renderer used, with its version; empty if none was used

    @property
    def status(self) -> str:
        """``passed``, ``failed`` or ``not made``."""
        return "failed" if self.findings else "passed" if self.checked else "not made"


@dataclass
class Findings:
    """Collects the findings of one proof."""

    items: list[Finding] = field(default_factory=list)
    checked: int = 0

    def expect(self, holds: bool, where: str, what: str) -> None:
        """Count a comparison, and note it where it does not hold."""
        self.checked += 1
        if not holds:
            self.items.append(Finding(where, what))

    def proof(self, claim: str, note: str = "", renderer: str = "") -> Proof:
        """Close the collection."""
        return Proof(claim, self.checked, tuple(self.items), note, renderer)


@dataclass(frozen=True)
class Audit:
    """All proofs of a dataset."""

    proofs: tuple[Proof, ...]

    @property
    def status(self) -> str:
        """``failed`` if any proof failed, else ``incomplete`` if any was not made, else ``passed``."""
        states = {proof.status for proof in self.proofs}
        return "failed" if "failed" in states else "incomplete" if "not made" in states else "passed"

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of all proofs."""
        return tuple(f for proof in self.proofs for f in proof.findings)
