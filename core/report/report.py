#!/usr/bin/env python3
"""Makes the report: one static HTML page with figures, and the CSV files behind it.

    /usr/bin/python3 core/report/report.py report.json --output FOLDER

`report.json` is written by `gpuphys report`. Needs matplotlib and jinja2 (Debian: python3-matplotlib, python3-jinja2),
no GPU and no network. Writes index.html and *.csv to FOLDER. Ends with code 5 and one line when the data are not usable.
"""

import argparse
import base64
import csv
import io
import json
import math
import os
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
import jinja2  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
from matplotlib import ticker  # noqa: E402

SCHEMA = 2

# Colours that stay apart for colour-blind readers (Okabe and Ito); every one goes with a marker or a word of its own.
BLUE, ORANGE, GREEN, SKY, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#56B4E9", "#CC79A7", "#6b6b6b"
VARIANT_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, GREY)

# Ratios are clipped to what an axis can show; a clipped value is drawn as an arrow head at the end of the axis.
LOWEST_RATIO, HIGHEST_RATIO = 1e-6, 1e8

plt.rcParams.update({
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "figure.dpi": 100,
    "savefig.dpi": 170,
})


def number(value):
    """A number of the data: JSON numbers and the strings "nan", "inf", "-inf"."""
    return float(value)


def short(value, digits=3):
    """Three significant digits; a dash for what is not known."""
    value = number(value)
    return "–" if math.isnan(value) else "∞" if math.isinf(value) else f"{value:.{digits}g}"


def data_uri(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight", pad_inches=0.05)
    plt.close(figure)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def plain_log_axis(axis, low, high):
    """A log axis from `low` to `high` with few labels, also when the range is less than a decade."""
    decades = math.log10(high / low)
    if decades > 1.2:
        axis.set_major_locator(ticker.LogLocator(base=10, numticks=6))
        axis.set_minor_formatter(ticker.NullFormatter())
    else:
        axis.set_major_locator(ticker.MaxNLocator(4, steps=[1, 2, 5, 10]))
        axis.set_minor_locator(ticker.NullLocator())
        axis.set_major_formatter(ticker.FuncFormatter(lambda v, _: f"{v:.3g}"))


def padded(values, factor):
    """The range of positive values, widened so that no marker lies on the frame and a single value gets a range."""
    low, high = min(values), max(values)
    grow = max(factor, math.sqrt(4 * low / high) if high < 4 * low else 1)
    return low / grow, high * grow


# ---- speed against error ----


def knob_text(overrides):
    return ", ".join(f"{number(v):g}" for v in overrides.values())


def measured_points(task):
    """The points of a task that have a place on logarithmic axes."""
    return [p for p in task["speed_error"] if number(p["milliseconds"]) > 0 and number(p["truth_gap"]) > 0
            and math.isfinite(number(p["truth_gap"]))]


def target_times(task):
    """Target in ms, by the floors measured with the task's timings."""
    if not number(task["target_multiple"]) > 0:
        return []
    return sorted({number(t["floor_ms"]) * number(task["target_multiple"]) for t in task["timing"]
                   if math.isfinite(number(t["floor_ms"]))})


def speed_error_axes(size, points, targets):
    """(figure, axes, range of x, range of y): time against distance to the FP64 truth, with room for all points."""
    figure, axes = plt.subplots(figsize=size)
    x_range = padded([number(p["milliseconds"]) for p in points] + targets, 1.25)
    y_range = padded([number(p["truth_gap"]) for p in points], 2.0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(*x_range)
    axes.set_ylim(*y_range)
    plain_log_axis(axes.xaxis, *x_range)
    plain_log_axis(axes.yaxis, *y_range)
    axes.set_xlabel("time, ms")
    axes.set_ylabel("distance to FP64 truth")
    return figure, axes, x_range, y_range


def speed_error_figure(task):
    """Time against distance to the FP64 truth of one task; None when nothing was measured."""
    points = measured_points(task)
    if not points:
        return None
    targets = target_times(task)
    figure, axes, x_range, y_range = speed_error_axes((3.9, 2.9), points, targets)
    for target in targets:
        axes.axvline(target, color=GREEN, linewidth=1, linestyle=(0, (4, 3)), zorder=1)

    sweeps = {}
    for p in points:
        if p["overrides"]:
            sweeps.setdefault((p["label"].split("@")[0], p["set"]), []).append(p)
    for line in sweeps.values():
        line.sort(key=lambda p: [number(v) for v in p["overrides"].values()])
        lx = [number(p["milliseconds"]) for p in line]
        ly = [number(p["truth_gap"]) for p in line]
        axes.plot(lx, ly, color=BLUE, linewidth=0.9, marker=".", markersize=5, zorder=2)
        label_sweep(axes, line, x_range, y_range)
    styles = {"reference": dict(marker="o", color=BLUE), "fmad": dict(marker="D", color=ORANGE),
              "user": dict(marker="^", color=PURPLE), "baseline": dict(marker="s", color=GREY)}
    for p in points:
        if p["overrides"]:
            continue
        style = dict(styles.get(p["role"], styles["user"]))
        # Hollow: the hidden set.
        face = "white" if p["set"].startswith("hidden") else style["color"]
        # The variant is smaller and on top: it often lies exactly where the reference does.
        size = 18 if p["role"] == "fmad" else 58
        axes.scatter(number(p["milliseconds"]), number(p["truth_gap"]), s=size, marker=style["marker"], facecolor=face,
                     edgecolor=style["color"], linewidth=1.3, zorder=4 if p["role"] == "fmad" else 3)
        if p["role"] == "user":
            axes.annotate(p["label"], (number(p["milliseconds"]), number(p["truth_gap"])), fontsize=6.5, color=PURPLE,
                          xytext=(5, 3), textcoords="offset points")
    axes.set_title(task["name"], fontsize=9, loc="left", fontweight="bold")
    return data_uri(figure)


def variant_groups(tasks):
    """(name, tasks) of every group of measured tasks that are variants of one computation: of one family, and with the
    same arrays and scalars going in and out."""
    groups = {}
    for task in tasks:
        if any(p["role"] == "reference" and not p["overrides"] for p in measured_points(task)):
            groups.setdefault((task["family"], task["interface"]), []).append(task)
    named = []
    for members in groups.values():
        if len(members) > 1:
            words = [t["name"].split("_") for t in members]
            first, last = os.path.commonprefix(words), os.path.commonprefix([w[::-1] for w in words])[::-1]
            named.append(("_".join(first) or " ".join([members[0]["family"], *last]), members))
    return named


def variants_figure(name, tasks):
    """The references and fmad variants of one group in one picture, each task in a colour of its own, with its target."""
    own = {t["name"]: [p for p in measured_points(t) if p["role"] in ("reference", "fmad") and not p["overrides"]]
           for t in tasks}
    targets = {t["name"]: target_times({**t, "timing": [main_timing(t)] if main_timing(t) else []}) for t in tasks}
    figure, axes, _, _ = speed_error_axes((8.2, 3.6), [p for points in own.values() for p in points],
                                          [target for times in targets.values() for target in times])
    for index, task in enumerate(tasks):
        points, color = own[task["name"]], VARIANT_COLOURS[index % len(VARIANT_COLOURS)]
        for p in points:
            fmad = p["role"] == "fmad"
            axes.scatter(number(p["milliseconds"]), number(p["truth_gap"]), s=18 if fmad else 58,
                         marker="D" if fmad else "o", facecolor="white" if p["set"].startswith("hidden") else color,
                         edgecolor=color, linewidth=1.3, zorder=4 if fmad else 3)
        main = next((p for p in points if p["role"] == "reference" and p["set"] == "public"), points[0])
        x, y = number(main["milliseconds"]), number(main["truth_gap"])
        for target in targets[task["name"]]:
            axes.plot([target, x], [y, y], color=color, linewidth=0.8, linestyle=(0, (2, 2)), zorder=1)
            axes.scatter(target, y, marker="|", s=130, color=color, linewidth=2.2, zorder=2)
        axes.annotate(task["name"].removeprefix(name).strip("_") or task["name"], (x, y), fontsize=8, color=color,
                      xytext=(0, 8), textcoords="offset points", ha="center", fontweight="bold", zorder=5)
    axes.set_title(name, fontsize=9, loc="left", fontweight="bold")
    return data_uri(figure)


def label_sweep(axes, line, x_range, y_range):
    """Writes the knob's value at the points of a sweep, leaving out those that would lie on another label."""
    placed = []
    for p in line:
        u = math.log(number(p["milliseconds"]) / x_range[0]) / math.log(x_range[1] / x_range[0])
        v = math.log(number(p["truth_gap"]) / y_range[0]) / math.log(y_range[1] / y_range[0])
        if any(abs(u - a) < 0.17 and abs(v - b) < 0.08 for a, b in placed):
            continue
        placed.append((u, v))
        right = u > 0.8
        axes.annotate(knob_text(p["overrides"]), (number(p["milliseconds"]), number(p["truth_gap"])), fontsize=6.5,
                      color="#333333", xytext=(-5, 5) if right else (5, 5), textcoords="offset points",
                      ha="right" if right else "left",
                      bbox=dict(facecolor="white", edgecolor="none", alpha=0.75, pad=0.4), zorder=5)


# ---- tolerance windows ----


def clip(ratio):
    """(position on the axis, marker override) of a ratio."""
    ratio = number(ratio)
    if math.isnan(ratio) or ratio >= HIGHEST_RATIO:
        return HIGHEST_RATIO, ">"
    if ratio <= LOWEST_RATIO:
        return LOWEST_RATIO, "<"
    return ratio, None


def window_axes(rows):
    height = 0.75 + 0.235 * rows
    figure, axes = plt.subplots(figsize=(8.2, height))
    axes.set_xscale("log")
    axes.set_xlim(LOWEST_RATIO / 2, HIGHEST_RATIO * 2)
    axes.xaxis.set_major_locator(ticker.LogLocator(base=10, numticks=15))
    axes.xaxis.set_minor_locator(ticker.NullLocator())
    axes.set_ylim(rows - 0.4, -0.6)
    axes.axvline(1, color="black", linewidth=1.2, zorder=2)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("error / tolerance")
    return figure, axes


def draw_ratios(axes, y, ratios, color, marker, hollow=False, size=4.5, alpha=0.9):
    """Markers at `ratios` in row y; arrow heads where the axis ends."""
    for shape in (None, "<", ">"):
        xs = [x for x, clipped in map(clip, ratios) if clipped == shape]
        axes.plot(xs, [y] * len(xs), linestyle="none", marker=shape or marker, markersize=size, color=color,
                  markerfacecolor="white" if hollow else color, markeredgewidth=1.0, alpha=alpha, zorder=3)


def window_band(axes, y, low, high):
    """Shades what lies between the worst correct variant and the weakest mutant; red where they overlap."""
    a, b = clip(low)[0], clip(high)[0]
    axes.barh(y, abs(b - a), left=min(a, b), height=0.62, color="#d8efe6" if a < b else "#f6d3c4", zorder=1)


def best_ratios(task):
    """Mutant run -> (ratio, check) of the check that sees it best. Non-finite errors are the largest ratios."""
    best = {}
    for w in task["windows"]:
        for m in w["mutant_runs"]:
            ratio = number(m["ratio"])
            candidate = (ratio if math.isfinite(ratio) else math.inf, w["check"])
            key = (m["lane"], m["label"], m["set"])
            if key not in best or candidate[0] > best[key][0]:
                best[key] = candidate
    return best


def window_overview(tasks):
    """One row a task: each check's worst correct variant, each mutant run at its best check."""
    rows = [t for t in tasks if t["windows"]]
    if not rows:
        return None
    figure, axes = window_axes(len(rows))
    for y, task in enumerate(rows):
        correct = [w["correct"]["ratio"] for w in task["windows"] if w["correct"]["label"]]
        best = [ratio for ratio, _ in best_ratios(task).values()]
        if correct and best:
            window_band(axes, y, max(clip(r)[0] for r in correct), min(best))
        draw_ratios(axes, y, correct, BLUE, "o")
        draw_ratios(axes, y, best, ORANGE, "|", size=7)
    axes.set_yticks(range(len(rows)), [t["name"] for t in rows])
    return data_uri(figure)


def window_figure(task):
    """One row a check: every correct variant, and every mutant run; faint where another check sees that run better."""
    if not task["windows"]:
        return None
    best = best_ratios(task)
    figure, axes = window_axes(len(task["windows"]))
    for y, w in enumerate(task["windows"]):
        if w["correct"]["label"] and w["mutant"]["label"]:
            window_band(axes, y, w["correct"]["ratio"], w["mutant"]["ratio"])
        for lane, hollow in (("cpu", True), ("gpu", False)):
            mine, others = [], []
            for m in w["mutant_runs"]:
                if m["lane"] == lane:
                    here = best[(m["lane"], m["label"], m["set"])][1] == w["check"]
                    (mine if here else others).append(m["ratio"])
            draw_ratios(axes, y, others, ORANGE, "D", hollow, 2.5, 0.45)
            draw_ratios(axes, y, [r["ratio"] for r in w["correct_runs"] if r["lane"] == lane], BLUE, "o", hollow)
            draw_ratios(axes, y, mine, ORANGE, "D", hollow, 4)
    axes.set_yticks(range(len(task["windows"])),
                    [f"{w['check']}  ({number(w['tolerance']):g})" for w in task["windows"]])
    return data_uri(figure)


# ---- timing ----


def main_timing(task):
    """The reference's timing on the public set, or on whichever set there is."""
    own = [t for t in task["timing"] if t["label"] == "reference"]
    return next((t for t in own if t["set"] == "public"), own[0] if own else None)


def timing_figure(tasks):
    rows = [(t, main_timing(t)) for t in tasks if main_timing(t) is not None]
    if not rows:
        return None
    figure, axes = plt.subplots(figsize=(8.2, 0.85 + 0.235 * len(rows)))
    values = [1.0]
    for y, (task, timing) in enumerate(rows):
        multiple, target = number(timing["multiple"]), number(task["target_multiple"])
        recorded = number(timing["gate"]["baseline_multiple"])
        values += [v for v in (multiple, target, recorded) if math.isfinite(v) and v > 0]
        slow = timing["gate"]["state"] not in ("OK", "UNBASELINED", "ACCEPTED")
        axes.barh(y, multiple - 1, left=1, height=0.62, color=ORANGE if slow else SKY, zorder=2)
        if target > 0:
            axes.scatter(target, y, marker="|", s=130, color=GREEN, linewidth=2.2, zorder=4)
        if math.isfinite(recorded):
            axes.scatter(recorded, y, marker="o", s=16, facecolor="white", edgecolor="black", linewidth=0.9, zorder=5)
        # Behind everything that is drawn in the row, so that no marker lies on the text.
        end = max(v for v in (multiple, target, recorded) if math.isfinite(v))
        axes.annotate(f"{short(timing['median_ms'])} ms", (end, y), xytext=(7, 0), textcoords="offset points",
                      va="center", fontsize=7)
    axes.set_xscale("log")
    axes.set_xlim(0.8, max(values) * 2.2)
    axes.axvline(1, color="black", linewidth=1.2, zorder=3)
    axes.xaxis.set_major_locator(ticker.LogLocator(base=10, subs=(1, 2, 5), numticks=20))
    axes.xaxis.set_major_formatter(ticker.FuncFormatter(lambda v, _: f"{v:g}"))
    axes.xaxis.set_minor_locator(ticker.NullLocator())
    axes.grid(axis="y", visible=False)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(range(len(rows)), [t["name"] for t, _ in rows])
    axes.set_xlabel("median time / floor (compulsory bytes at the measured copy bandwidth)")
    return data_uri(figure)


# ---- tables ----


def kill_table(task):
    checks = []
    for row in task["kills"]:
        checks += [c for c in row["ratios"] if c not in checks]
    rows = []
    for row in task["kills"]:
        cells = []
        for check in checks:
            if check not in row["ratios"]:
                cells.append(("–", "none"))
                continue
            ratio = number(row["ratios"][check])
            seen = not ratio <= 1
            strength = "strong" if not ratio < 10 else "weak"
            cells.append((short(ratio, 2), f"seen-{strength}" if seen else "unseen"))
        alive = [f"{state} on {name}" for name, state in sorted(row["states"].items()) if state != "KILLED"]
        rows.append({**row, "cells": cells, "state": ", ".join(alive) or "KILLED", "good": not alive})
    return {"checks": checks, "rows": rows}


def hard_table(task):
    labels, cases = [], {}
    for h in task["hard"]:
        name = f"{h['label']} ({h['lane']})"
        if name not in labels:
            labels.append(name)
        cases.setdefault(h["set"], {"about": h["about"], "cells": {}})["cells"][name] = h
    return {"labels": labels, "cases": cases}


# ---- CSV ----


def write_csv(folder, name, header, rows):
    with open(folder / name, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_tables(folder, tasks):
    write_csv(folder, "verdict.csv",
              ["task", "family", "state", "serial_fp32_ratio", "reference_ratio", "fmad_ratio", "truth_gap", "truth_gap_of",
               "weakest_mutant", "weakest_mutant_ratio", "separation", "mutants_killed", "mutants_total", "median_ms",
               "floor_multiple", "target_multiple", "hard_passed", "hard_total", "issues"],
              [[t["name"], t["family"], v["state"], v["serial_fp32"]["ratio"], v["reference"]["ratio"], v["fmad"]["ratio"],
                v["truth_gap"], v["truth_gap_of"], v["weakest_mutant"]["label"], v["weakest_mutant"]["ratio"],
                v["separation"], v["mutants_killed"], v["mutants_total"], v["milliseconds"], v["multiple"],
                t["target_multiple"], v["hard_passed"], v["hard_total"], len(t["issues"])]
               for t in tasks for v in [t["verdict"]]])
    write_csv(folder, "speed_error.csv",
              ["task", "label", "role", "set", "milliseconds", "truth_gap", "truth_source", "state", "overrides"],
              [[t["name"], p["label"], p["role"], p["set"], p["milliseconds"], p["truth_gap"],
                p["truth_source"], p["state"], json.dumps(p["overrides"])] for t in tasks for p in t["speed_error"]])
    write_csv(folder, "windows.csv",
              ["task", "check", "kind", "quantity", "norm", "tolerance", "largest_correct_ratio", "largest_correct",
               "largest_correct_set", "smallest_mutant_ratio", "smallest_mutant", "smallest_mutant_set", "separation"],
              [[t["name"], w["check"], w["kind"], w["quantity"], w["norm"], w["tolerance"], w["correct"]["ratio"],
                w["correct"]["label"], w["correct"]["set"], w["mutant"]["ratio"], w["mutant"]["label"],
                w["mutant"]["set"], w["separation"]] for t in tasks for w in t["windows"]])
    write_csv(folder, "window_runs.csv", ["task", "check", "correct", "label", "lane", "set", "ratio"],
              [[t["name"], w["check"], kind == "correct_runs", r["label"], r["lane"], r["set"], r["ratio"]]
               for t in tasks for w in t["windows"] for kind in ("correct_runs", "mutant_runs") for r in w[kind]])
    write_csv(folder, "kills.csv",
              ["task", "lane", "mutant", "class", "expected_check", "expected_check_saw_it", "sparse", "check", "ratio",
               "killed_everywhere"],
              [[t["name"], k["lane"], k["label"], k["class"], k["expected_check"], k["expected_check_saw_it"], k["sparse"],
                check, ratio, k["killed_everywhere"]] for t in tasks for k in t["kills"] for check, ratio in k["ratios"].items()])
    write_csv(folder, "timing.csv",
              ["task", "label", "set", "median_ms", "min_ms", "spread", "floor_ms", "multiple", "target_multiple",
               "recorded_multiple", "limit", "gate", "device", "driver", "toolkit", "origin"],
              [[t["name"], x["label"], x["set"], x["median_ms"], x["min_ms"], x["spread"], x["floor_ms"], x["multiple"],
                t["target_multiple"], x["gate"]["baseline_multiple"], x["gate"]["limit"], x["gate"]["state"],
                x["device"], x["driver"], x["toolkit"], x["origin"]] for t in tasks for x in t["timing"]])
    write_csv(folder, "hard_cases.csv", ["task", "case", "label", "lane", "state", "worst_ratio", "detail", "stresses"],
              [[t["name"], h["set"], h["label"], h["lane"], h["state"], h["worst_ratio"], h["detail"], h["about"]]
               for t in tasks for h in t["hard"]])
    write_csv(folder, "issues.csv", ["task", "issue"], [[t["name"], i] for t in tasks for i in t["issues"]])


def make_page(data):
    tasks = data["tasks"]
    for index, task in enumerate(tasks):
        if sys.stderr.isatty():
            print(f"\r\033[Kfigures {index + 1}/{len(tasks)} {task['name']}", end="", file=sys.stderr, flush=True)
        task["figure_speed"] = speed_error_figure(task)
        task["figure_windows"] = window_figure(task)
        task["kill_table"] = kill_table(task)
        task["hard_table"] = hard_table(task)
        task["main_timing"] = main_timing(task)
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    states = {}
    for task in tasks:
        states[task["verdict"]["state"]] = states.get(task["verdict"]["state"], 0) + 1
    devices = sorted({f"{t['device']}, driver {t['driver']}, CUDA {t['toolkit']}" for task in tasks for t in task["timing"]})
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(pathlib.Path(__file__).parent), autoescape=True,
                                     undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["short"] = short
    return environment.get_template("page.html.j2").render(
        data=data, tasks=tasks, states=sorted(states.items()), devices=devices, figure_windows=window_overview(tasks),
        figure_timing=timing_figure(tasks), number=number,
        figures_variants=[(name, variants_figure(name, members)) for name, members in variant_groups(tasks)])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=pathlib.Path, help="report.json of `gpuphys report`")
    parser.add_argument("--output", type=pathlib.Path, required=True, help="folder to write to")
    arguments = parser.parse_args()
    try:
        data = json.loads(arguments.data.read_text(encoding="utf-8"))
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            raise ValueError(f"it is not report data of schema {SCHEMA}")
    except (OSError, ValueError) as error:
        print(f"report: '{arguments.data}': {error}", file=sys.stderr)
        return 5
    arguments.output.mkdir(parents=True, exist_ok=True)
    write_tables(arguments.output, data["tasks"])
    page = make_page(data)
    temporary = arguments.output / "index.html.tmp"
    temporary.write_text(page, encoding="utf-8")
    temporary.replace(arguments.output / "index.html")
    return 0


if __name__ == "__main__":
    sys.exit(main())
