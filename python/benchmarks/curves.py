"""Draws columns of learning curves as a picture::

python python/benchmarks/curves.py runs/hand/curve.csv docs/pictures/training_hand.svg \\
    "reward a second=reward" "successes in 1,000 decisions=successes_per_1000_steps" "learning rate=learning_rate"

Each further argument is a panel: a title and a column of ``curve.csv``, against millions of samples.
"""

import argparse
import csv
import json
import math
from pathlib import Path

WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 260, 180, 56, 28, 34
"""Of a panel and its margins, pixels."""


def panel(title: str, points: list[tuple[float, float]], place: int) -> str:
    """A panel of the picture, as SVG."""
    end = max(x for x, _ in points)
    low, high = min(0.0, *(y for _, y in points)), max(0.0, *(y for _, y in points))
    if high == low:
        high = low + 1.0
    across, up = WIDTH - LEFT - 12, HEIGHT - TOP - BOTTOM

    def at(x: float, y: float) -> str:
        return f"{LEFT + across * x / end:.1f},{TOP + up * (high - y) / (high - low):.1f}"

    line = " ".join(at(x, y) for x, y in points)
    zero = at(0, 0).split(",")[1]
    return (
        f'<g transform="translate({place * WIDTH} 0)"><text x="{LEFT}" y="16" font-weight="bold">{title}</text>'
        f'<path d="M{LEFT} {TOP}V{TOP + up}M{LEFT} {zero}h{across}" stroke="#999" fill="none"/>'
        f'<text x="{LEFT - 6}" y="{TOP + 4}" text-anchor="end">{high:.2g}</text>'
        f'<text x="{LEFT - 6}" y="{TOP + up + 4}" text-anchor="end">{low:.2g}</text>'
        f'<text x="{LEFT + across}" y="{HEIGHT - 12}" text-anchor="end">{end:.2g} million samples</text>'
        f'<polyline points="{line}" fill="none" stroke="#1f6fb2" stroke-width="2"/></g>'
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Draws columns of a learning curve as a picture.")
    parser.add_argument("curve", type=Path, help="curve.csv of a run")
    parser.add_argument("out", type=Path, help="the .svg to write")
    parser.add_argument("panels", nargs="+", metavar="TITLE=COLUMN", help="a panel each")
    parser.add_argument("--json", action="store_true", help="print the first and the last value of each panel as JSON")
    arguments = parser.parse_args()
    with arguments.curve.open(newline="") as file:
        rows = list(csv.DictReader(file))
    drawn, ends = [], {}
    for place, given in enumerate(arguments.panels):
        title, _, column = given.partition("=")
        if not rows or column not in rows[0]:
            raise SystemExit(f"{arguments.curve} has no column {column!r}; it has {', '.join(rows[0] if rows else ())}")
        points = [(float(row["samples"]) / 1e6, float(row[column])) for row in rows if row[column]]
        points = [point for point in points if math.isfinite(point[1])]
        if not points:
            raise SystemExit(f"{arguments.curve}: the column {column!r} is empty")
        drawn.append(panel(title, points, place))
        ends[title] = [points[0][1], points[-1][1]]
    size = f'width="{WIDTH * len(drawn)}" height="{HEIGHT}" viewBox="0 0 {WIDTH * len(drawn)} {HEIGHT}"'
    style = 'font-family="sans-serif" font-size="12" fill="#333"'
    background = '<rect width="100%" height="100%" fill="#fff"/>'
    arguments.out.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {style}>{background}{"".join(drawn)}</svg>\n'
    )
    lines = [f"{title}: {first:.4g} to {last:.4g}" for title, (first, last) in ends.items()]
    print(json.dumps(ends) if arguments.json else "\n".join(lines))


if __name__ == "__main__":
    main()
