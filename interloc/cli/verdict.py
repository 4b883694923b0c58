"""`interloc verdict`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli import console, options

if TYPE_CHECKING:
    from interloc.city.verdicts import Verdict


@click.command(short_help="Say whether findings of an audit are right.")
@click.argument("city", type=options.PATH)
@click.argument("finding", required=False)
@click.argument("verdict", required=False, type=click.Choice(["right", "wrong", "cannot_tell", "fixed"]))
@click.option("--audit", required=True, type=options.PATH, help="Folder that `interloc audit` wrote.")
@click.option("--by", metavar="NAME", help="Who says so.", envvar="USER", default="unknown", show_envvar=True)
@click.option("--note", help="Why.")
@options.JSON
def command(city: Path, finding: str | None, verdict: Verdict | None, audit: Path, by: str, note: str | None) -> None:
    """Keep what you saw of FINDING in verdicts.jsonl of CITY; without a finding, list those that nobody looked at.

    A place marked wrong never comes back, whatever is merged later. The precision of the findings, with an interval of
    95 %, is told by all verdicts.

    \b
    Examples:
      interloc verdict city --audit audit
      interloc verdict city missing_branch-p01ab23cd45ef wrong --audit audit --note "a driveway"
    """
    from datetime import UTC, datetime

    from interloc.city.delivery import FINDINGS_FILE
    from interloc.city.folder import is_city
    from interloc.city.verdicts import VERDICTS_FILE, Precision, add_verdicts, judgement_of, latest, read_verdicts
    from interloc.errors import ConfigError
    from interloc.output.geojson import read_json

    if not is_city(city):
        raise ConfigError(f"{city} is not a map of many drives. Give the folder that `interloc merge` wrote.")
    features = {str(each["id"]): each for each in read_json(audit / FINDINGS_FILE)["features"]}
    if finding is not None:
        if verdict is None:
            raise click.UsageError("say what it is: right, wrong, cannot_tell or fixed")
        if finding not in features:
            raise ConfigError(f"{audit} has no finding {finding!r}. It has: {', '.join(features) or 'none'}.")
        judgement = judgement_of(features[finding], verdict, by, datetime.now(UTC), note)
        add_verdicts(city / VERDICTS_FILE, [judgement])
    last = latest(read_verdicts(city / VERDICTS_FILE))
    left = [each for name, each in features.items() if name not in last]
    found = Precision.of(each.verdict for each in last.values())
    if console.wants_json():
        console.say_json({"precision": vars(found), "open": [each["id"] for each in left]})
        return
    if finding is None:
        for each in left:
            click.echo(f"{each['id']}  {each['properties']['osm_link']}")
    told = "none yet"
    if found.share is not None and found.low is not None and found.high is not None:
        told = f"{found.share:.0%} right ({found.low:.0%} to {found.high:.0%}), {found.wrong} wrong"
    console.say_facts([("open", str(len(left))), ("verdicts", told)])
