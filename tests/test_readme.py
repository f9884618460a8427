"""What the README shows works as it stands there."""

import re
from pathlib import Path

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_example_of_an_own_test_runs() -> None:
    examples = [code for code in re.findall(r"```python\n(.*?)```", README, re.DOTALL) if "Verdict" in code]
    assert len(examples) == 1
    names: dict[str, object] = {}
    exec(examples[0], names)  # noqa: S102
    assert names["carved"].volume.n_occupied > 1000  # type: ignore[attr-defined]


def test_every_command_that_the_readme_types_exists() -> None:
    from recon3d.cli.entry import app

    known = {command.name for command in app.registered_commands}
    blocks = "".join(re.findall(r"```\n(.*?)```", README, re.DOTALL))
    typed = set(re.findall(r"^recon3d (\w+)", blocks, re.MULTILINE))
    assert typed
    assert typed <= known
