"""Planned sessions against what the diagnosis then finds: detection limits and isolability, promised and reached.

A bench (sensors, noise, causes of interest) is drawn and planned; a valve within its tolerances is drawn, with one
cause at the amplitude that the plan promises to detect nine times in ten, then with one at the amplitude from which it
promises to tell it from the other causes of the aim. Its records are simulated under the planned commands (the same
equations, so that the plan alone is judged and not the model), and diagnosed.

    python benchmarks/planned_sessions.py [SESSIONS] [FIRST_SEED] [OUTPUT.jsonl]
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from valvesim.diagnosis.answer_tables import detection_limits
from valvesim.diagnosis.detection import detect
from valvesim.diagnosis.diagnose import diagnose
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS
from valvesim.diagnosis.score_test import score_test
from valvesim.identification.nominal_fit import fit_nominal
from valvesim.identification.predictor import prepare_record
from valvesim.identification.study import prepare_session
from valvesim.planning.options import DEFAULT_PLANNING
from valvesim.planning.outlook import CandidateScores, cause_groups
from valvesim.planning.plan import plan_tests
from valvesim.planning.plan_toml import read_plan
from valvesim.planning.sensitivities import planned_record, white_noise
from valvesim.valve.catalogue import CATALOGUE

SENSORS = {
    "spool_position": ("um", 1.0), "load_flow": ("L/min", 0.05), "nozzle_pressure_1": ("bar", 0.05),
    "nozzle_pressure_2": ("bar", 0.05), "internal_leakage": ("L/min", 0.005), "armature_angle": ("urad", 1.0),
}  # fmt: skip
CAUSES = (
    "magnetic_hysteresis", "magnetic_saturation", "eddy_current_lag", "fixed_orifice_clogging", "nozzle_erosion",
    "null_gap_asymmetry", "flapper_cavitation", "supply_pressure_droop", "return_pressure_rise",
    "spool_coulomb_friction", "spool_stribeck_friction", "spool_silting", "feedback_ball_backlash", "spool_edge_wear",
    "spool_lap", "flexure_stiffness_loss", "magnet_demagnetization",
)  # fmt: skip
TESTS = (
    "fast chirp of medium size, 2 to 150 Hz", "slow full triangle", "slow small triangle about null",
    "filtered random steps", "fast chirp at low supply pressure", "holds with small releases",
)  # fmt: skip


def drawn_bench(rng: np.random.Generator) -> dict:
    """The table of a plan: two to four sensors with their noise, two to four causes, three to six tests."""
    names = ["spool_position", *rng.choice(list(SENSORS)[1:], rng.integers(1, 4), replace=False)]
    sensors = {n: {"noise": f"{SENSORS[n][1] * 10 ** rng.uniform(-0.4, 0.6):.3g} {SENSORS[n][0]}"} for n in names}
    tests = rng.choice(TESTS, rng.integers(3, 7), replace=False).tolist()
    return {
        "thermal": {"isothermal": True}, "sensors": sensors,
        "bench": {"rate": "1 kHz", "setup": "20 s", "tests": tests},
        "aim": {"causes": rng.choice(CAUSES, rng.integers(2, 5), replace=False).tolist()},
    }  # fmt: skip


def measured(plan, candidate, amplitude: float, rng: np.random.Generator):
    """The session of a valve within its tolerances with one cause, on the planned tests."""
    session = replace(plan.bench.session, sensors={s.channel: s for s in plan.bench.sensors})
    channels = tuple(session.sensors)
    nominal = plan.planned.nominal
    point = np.array([rng.normal() if p.sensor is None or p.sensor.channel in channels else 0.0
                      for p in nominal.parameters])  # fmt: skip
    variant = candidate.apply_to(nominal.at(np.clip(point, -2.0, 2.0)), amplitude)
    records = []
    for test in plan.tests:
        for k in range(test.repeats):
            record = planned_record(session, test.experiment, channels, options=DEFAULT_DIAGNOSIS)
            predictor = prepare_record(
                replace(session, records=(record,)), record, tuple(CATALOGUE.values()),
                options=DEFAULT_DIAGNOSIS.identification,
            )  # fmt: skip
            read = predictor.readings(predictor.run(variant), variant)
            values = dict(record.values)
            for name in channels:
                noise = white_noise(session.sensors[name]).innovation
                values[name] = read[name] + noise * rng.normal(size=len(record.time))
            name = f"{test.experiment.description} {k + 1}"
            records.append(replace(record, name=name, values=values,
                                   repeats=test.experiment.description if test.repeats > 1 else None))  # fmt: skip
    return replace(session, records=tuple(records))


def judged(seed: int) -> dict:
    """One planned session: what was promised and what came."""
    rng = np.random.default_rng(seed)
    for _ in range(20):
        table = drawn_bench(rng)
        plan = plan_tests(read_plan(Path("."), table))
        promised = [one for one in plan.outlook.causes if one.limit is not None]
        if promised and plan.tests:
            break
    groups = cause_groups(plan.planned.candidates)
    cause = promised[rng.integers(len(promised))]
    own = [plan.planned.candidates[k] for k in groups[cause.label]]
    candidate = next(c for c in own if set(cause.shape) <= set(c.fixed))
    found = {"seed": seed, "cause": cause.label, "sensors": list(table["sensors"]), "tests": len(plan.tests),
             "aim": [one.label for one in plan.outlook.causes], "limit": cause.limit, "isolated": cause.isolated,
             "nearest": cause.nearest, "nearest_isolated": cause.nearest_isolated,
             "level": plan.outlook.level}  # fmt: skip
    begun = time.process_time()
    session = measured(plan, candidate, cause.limit, rng)
    nominal = fit_nominal(prepare_session(session, options=DEFAULT_DIAGNOSIS.identification))
    scores = score_test(nominal, nominal.fit, options=DEFAULT_DIAGNOSIS)
    alarm, level = detect(scores)
    z = scores.z()
    own = [k for k, c in enumerate(scores.candidates) if c.label == cause.label]
    told = {limit.label: limit.amplitude for limit in detection_limits(scores, level)}
    q = len(scores.candidates)
    own_scores = replace(scores.projected, score=scores.projected.score[:q], overlap=scores.projected.overlap[:q, :q])
    own_plan = replace(plan.planned, candidates=scores.candidates, sizes=scores.sizes)
    seen = CandidateScores(own_plan, own_scores, level, DEFAULT_PLANNING)
    told_groups = cause_groups(scores.candidates)
    rivals = [told_groups[label] for label in found["aim"] if label != cause.label and label in told_groups]
    k = min(told_groups[cause.label], key=seen.limit)
    found["told_isolated"] = max([seen.named(k), *(seen.isolated(k, one) for one in rivals if not seen._same(k, one))])
    distances = [float(scores.projected.distance[k] * cause.limit / abs(scores.sizes[k])) for k in own]
    found |= {"alarm": bool(alarm), "z": float(max(z[own], default=0.0)), "told_level": level,
              "told_limit": told.get(cause.label), "distance": max(distances),
              "fit_cpu": time.process_time() - begun}  # fmt: skip
    if cause.isolated is not None:
        begun = time.process_time()
        answer = diagnose(measured(plan, candidate, cause.isolated, rng))
        in_set = [c.label for c in answer.candidates if c.in_set]
        rivals = [label for label in found["aim"] if label != cause.label]
        found |= {"verdict": answer.verdict, "in_set": in_set, "true_in_set": cause.label in in_set,
                  "rivals_in_set": [label for label in in_set if label in rivals],
                  "diagnosis_cpu": time.process_time() - begun}  # fmt: skip
    return found


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    path = Path(sys.argv[3]) if len(sys.argv) > 3 else Path("benchmarks/results/planned_sessions.jsonl")
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a", encoding="utf-8") as file:
        for seed in range(first, first + count):
            file.write(json.dumps(judged(seed)) + "\n")
            file.flush()
    summary([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()])


def summary(rows: list[dict]) -> None:
    """What came of all sessions."""
    ratios = np.array([row["told_limit"] / row["limit"] for row in rows if row["told_limit"]])
    alarms = [row["alarm"] for row in rows]
    isolated = [row for row in rows if "verdict" in row]
    pairs = [(row["told_isolated"], row["isolated"]) for row in rows if row.get("told_isolated") and row["isolated"]]
    shares = np.array([told / planned for told, planned in pairs if np.isfinite(told)])
    if len(shares):
        print(f"isolation limit after the fit over the planned one: median {np.median(shares):.3f}, "
              f"within 20 % in {np.mean(np.abs(np.log(shares)) < np.log(1.2)):.0%} of {len(shares)}")  # fmt: skip
    kept = [row["true_in_set"] and not row["rivals_in_set"] for row in isolated]
    print(f"{len(rows)} planned sessions")
    print(f"limit that the diagnosis tells over the planned one: median {np.median(ratios):.3f}, "
          f"within 20 % in {np.mean(np.abs(np.log(ratios)) < np.log(1.2)):.0%} of {len(ratios)}")  # fmt: skip
    print(f"cause at its planned limit raises the alarm: {np.mean(alarms):.0%} (promised 90 %)")
    print(f"cause at its planned size is told from the others of the aim: {np.mean(kept):.0%} of {len(kept)}")
    print(f"  true cause in the answer: {np.mean([row['true_in_set'] for row in isolated]):.0%}")


if __name__ == "__main__":
    main()
