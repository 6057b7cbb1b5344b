#!/usr/bin/env python3
"""Writes random conformance cases, with the results of a Python model that shares no code with Situ.

    test/conformance/model.py --seed 7 --cases 25 > priv/conformance/situ_model.json

The model applies the definition of each operator to its complete inputs, without queues, processes and order of
arrival. `--cases` is the number per area. Different seeds give different cases, so a folder of them is a soak test.
"""
import argparse
import json
import random

SELECTORS = {"list": list, "sum": sum, "count": len}
GUARANTEES = {"v is even": lambda v: v % 2 == 0, "v mod 3 == 0": lambda v: v % 3 == 0, "v > 4": lambda v: v > 4}
INTERPOLATORS = ["nearest", "first", "last", "exact", "linear"]
EXACT = dict(left_ticks=0, left_bounded=True, left_inclusive=True, right_ticks=0, right_bounded=True, right_inclusive=True)
DEFAULT = -7
UNDECIDED = {"type": "insufficient_data"}


def random_window(left_bounded=False, ordered=True):
    bounded = [left_bounded or R.random() < 0.8, R.random() < 0.8]
    ends = [R.randint(-12, 12), R.randint(-12, 12)]
    if ordered and all(bounded):
        ends.sort()
    result = {}
    for side, end, is_bounded in zip(("left", "right"), ends, bounded):
        result[side + "_ticks"] = end if is_bounded else None
        result[side + "_bounded"] = is_bounded
        result[side + "_inclusive"] = is_bounded and R.random() < 0.6
    return result


def is_before(distance, w):
    end = w["left_ticks"]
    return w["left_bounded"] and (distance < end or (distance == end and not w["left_inclusive"]))


def is_past(distance, w):
    end = w["right_ticks"]
    return w["right_bounded"] and (distance > end or (distance == end and not w["right_inclusive"]))


def is_inside(distance, w):
    return not is_before(distance, w) and not is_past(distance, w)


def random_messages(n=None, low=0, high=40):
    n = R.randint(0, 6) if n is None else n
    return [{"t_ticks": t, "v": i + 1} for i, t in enumerate(sorted(R.sample(range(low, high), n)))]


def missing_result(obsolete):
    # Times before the first representable one are clamped to it.
    return {"type": "does_not_exist", "obsolete_ticks": max(0, obsolete)}


def created_result(value, obsolete):
    return {"type": "created", "value": value, "obsolete_ticks": max(0, obsolete)}


def interpolate_at(kind, w, t, queue, closed):
    family, name = kind.split(".")
    plain = name.replace("_or_default", "")
    w = EXACT if plain == "exact" else w
    waits = family == "reproducible" and not closed
    if not queue:
        result = UNDECIDED if waits else missing_result(0)
    else:
        result = FINDERS[plain](w, t, queue, waits)
    if name != plain and result["type"] == "does_not_exist":
        return created_result(DEFAULT, result["obsolete_ticks"])
    return result


def find_nearest(w, t, queue, waits):
    reach = t if not w["right_bounded"] else min(t, t + w["right_ticks"])
    fitting = [m for m in queue if is_inside(m["t_ticks"] - t, w)]
    newest = queue[-1]["t_ticks"]
    if fitting:
        # Two equally near messages: the later one is used.
        best = min(reversed(fitting), key=lambda m: abs(m["t_ticks"] - t))
        if waits and best is queue[-1] and best["t_ticks"] < reach:
            return UNDECIDED
        return created_result(best["v"], best["t_ticks"])
    if waits and (not w["right_bounded"] or newest < t + w["right_ticks"]):
        return UNDECIDED
    return missing_result(reach)


def find_first(w, t, queue, waits):
    for m in queue:
        if is_inside(m["t_ticks"] - t, w):
            return created_result(m["v"], m["t_ticks"])
    return UNDECIDED if waits and not is_past(queue[-1]["t_ticks"] - t, w) else missing_result(t + w["left_ticks"])


def find_last(w, t, queue, waits):
    fitting = [m for m in queue if is_inside(m["t_ticks"] - t, w)]
    beyond = is_past(queue[-1]["t_ticks"] - t, w)
    if fitting:
        at = fitting[-1]["t_ticks"]
        at_the_end = w["right_bounded"] and w["right_inclusive"] and at == t + w["right_ticks"]
        return created_result(fitting[-1]["v"], at) if not waits or beyond or at_the_end else UNDECIDED
    return UNDECIDED if waits and not beyond else missing_result(t + w["left_ticks"] if w["left_bounded"] else 0)


def interpolate_linear(_w, t, queue, waits):
    later = next((i for i, m in enumerate(queue) if m["t_ticks"] >= t), None)
    if later is None:
        return UNDECIDED if waits else missing_result(queue[-1]["t_ticks"])
    b = queue[later]
    if b["t_ticks"] == t:
        return created_result(b["v"], t)
    if later == 0:
        return missing_result(0)
    a = queue[later - 1]
    ratio = (t - a["t_ticks"]) / (b["t_ticks"] - a["t_ticks"])
    return created_result(a["v"] + (b["v"] - a["v"]) * ratio, a["t_ticks"])


FINDERS = {
    "nearest": find_nearest,
    "exact": find_nearest,
    "first": find_first,
    "last": find_last,
    "linear": interpolate_linear,
}


def random_interpolator(available=False):
    name = R.choice(INTERPOLATORS)
    family = "available" if available and name != "linear" and R.random() < 0.5 else "reproducible"
    w = random_window(left_bounded=name == "first")
    kind = f"{family}.{name}" + ("_or_default" if R.random() < 0.3 else "")
    spec = {"kind": kind}
    if name in ("nearest", "first", "last"):
        spec["window"] = w
    if "default" in kind:
        spec["default"] = DEFAULT
    return kind, w, spec


def interpolation_case(i):
    kind, w, spec = random_interpolator(available=True)
    queue, t = random_messages(), R.randint(0, 45)
    closed = None if R.random() < 0.6 else (queue[-1]["t_ticks"] if queue else 0) + R.randint(0, 5)
    params = {"interpolation_time_ticks": t, "tolerance_on_value": 1e-7}
    params.update({k: v for k, v in spec.items() if k != "kind"})
    stream = {"stream": "secondary", "messages": queue, "closed_at_ticks": closed}
    return build_case(f"model-interpolation-{i}", "interpolator." + kind, params, [stream], interpolate_at(kind, w, t, queue, closed is not None))


def fusion_case(i):
    op = R.choice(["fuse", "join", "fuse.vector", "join.vector", "join.chain"])
    kind, w, spec = random_interpolator()
    count = 1 if op in ("fuse", "join") and R.random() < 0.7 else R.randint(1, 3)
    primary, others = random_messages(R.randint(0, 8)), [random_messages(R.randint(0, 8)) for _ in range(count)]
    expect = []
    for m in primary:
        found = [interpolate_at(kind, w, m["t_ticks"], o, True) for o in others]
        if all(f["type"] == "created" for f in found):
            values = [f["value"] for f in found]
            flat = op not in ("fuse", "join") or count == 1
            expect.append({"t_ticks": m["t_ticks"], "v": [m["v"]] + values if flat else [m["v"], values]})
    return build_case(f"model-fusion-{i}", op, {"interpolator": spec}, build_streams([primary] + others), expect)


def pair_case(i):
    primary = random_messages(R.randint(0, 8))
    taken = {m["t_ticks"] for m in primary}
    secondary = [m for m in random_messages(R.randint(0, 8)) if m["t_ticks"] not in taken]
    initial = R.choice([None, -1])
    expect = []
    for m in primary:
        value = ([initial] + [s["v"] for s in secondary if s["t_ticks"] < m["t_ticks"]])[-1]
        if value is not None:
            expect.append({"t_ticks": m["t_ticks"], "v": [m["v"], value]})
    return build_case(f"model-pair-{i}", "pair", {"initial_value": initial}, build_streams([primary, secondary]), expect)


def zip_case(i):
    inputs, open_ = [random_messages(R.randint(0, 6), 0, 15) for _ in range(R.randint(1, 4))], R.random() < 0.4
    frontier = min((s[-1]["t_ticks"] if s else -1) for s in inputs) if open_ else float("inf")
    times = sorted({m["t_ticks"] for s in inputs for m in s if m["t_ticks"] <= frontier})
    expect = [{"t_ticks": t, "v": [m["v"] for s in inputs for m in s if m["t_ticks"] == t]} for t in times]
    return build_case(f"model-zip-{i}", "zip", {}, build_streams(inputs, keep_open=open_), expect)


def index_window_case(i):
    queue, select = random_messages(R.randint(0, 9)), R.choice(list(SELECTORS))
    a, b = (R.randint(-4, 4), R.random() < 0.7), (R.randint(-4, 4), R.random() < 0.7)
    left, right = sorted((a, b), key=lambda end: end[0])
    low, high = left[0] + (not left[1]), right[0] - (not right[1])
    if low > high:
        return index_window_case(i)
    expect = [
        {"t_ticks": m["t_ticks"], "v": SELECTORS[select]([x["v"] for x in queue[k + low : k + high + 1]])}
        for k, m in enumerate(queue)
        if k + low >= 0 and k + high < len(queue)
    ]
    params = {"from": a[0], "from_inclusive": a[1], "to": b[0], "to_inclusive": b[1], "selector": select}
    return build_case(f"model-index-window-{i}", "window.index", params, build_streams([queue]), expect)


def time_window_case(i):
    queue, select, w, open_ = random_messages(R.randint(0, 9)), R.choice(list(SELECTORS)), random_window(ordered=False), R.random() < 0.4
    ordered = dict(w)
    if w["left_bounded"] and w["right_bounded"] and w["left_ticks"] > w["right_ticks"]:
        for key in ("ticks", "inclusive"):
            ordered["left_" + key], ordered["right_" + key] = w["right_" + key], w["left_" + key]
    expect = []
    for m in queue:
        t = m["t_ticks"]
        if open_ and not (ordered["right_bounded"] and queue[-1]["t_ticks"] >= t + ordered["right_ticks"]):
            continue
        expect.append({"t_ticks": t, "v": SELECTORS[select]([x["v"] for x in queue if is_inside(x["t_ticks"] - t, ordered)])})
    params = {"selector": select}
    for side, name in (("left", "from"), ("right", "to")):
        params[name + "_ticks"], params[name + "_inclusive"] = w[side + "_ticks"], w[side + "_inclusive"]
    return build_case(f"model-time-window-{i}", "window.time", params, build_streams([queue], keep_open=open_), expect)


def sampling_case(i):
    kind, w, spec = random_interpolator()
    source, name = random_messages(R.randint(0, 8)), R.choice(["sample", "interpolate"])
    if R.random() < 0.5:
        clock = random_messages(R.randint(0, 8))
        op, params, inputs, ticks = name + ".by_clock", {"interpolator": spec}, [source, clock], [m["t_ticks"] for m in clock]
    else:
        step, align = R.randint(1, 12), R.choice([None, R.randint(-20, 20)])
        end = (source[-1]["t_ticks"] if source else 0) + R.randint(0, 20)
        params = {"interpolator": spec, "interval_ticks": step, "pipeline_ends_at_ticks": end}
        if align is not None:
            params["align_to_ticks"] = align
        op, inputs, ticks = name + ".by_interval", [source], range(0 if align is None else align % step, end + 1, step)
    found = [(t, interpolate_at(kind, w, t, source, True)) for t in ticks]
    expect = [{"t_ticks": t, "v": f["value"]} for t, f in found if f["type"] == "created"]
    return build_case(f"model-sampling-{i}", op, params, build_streams(inputs), expect)


def queue_case(i):
    policy = {}
    if R.random() < 0.7:
        policy["max_queue"] = R.randint(1, 4)
    if R.random() < 0.4:
        policy["max_latency_ms"] = R.randint(0, 15)
    if R.random() < 0.5:
        policy["guarantee"] = R.choice(list(GUARANTEES))
    protected = GUARANTEES.get(policy.get("guarantee"), lambda v: False)
    limit, latency = policy.get("max_queue", 10**9), policy.get("max_latency_ms", 10**9)
    queue, dropped, steps, now, value, closed = [], [], [], 0, 0, False
    for _ in range(R.randint(1, 14)):
        dice = R.random()
        if dice < 0.65 and not closed:
            now += R.randint(1, 5)
            keep = True
            if len(queue) >= limit:
                victim = next((k for k, (v, _) in enumerate(queue) if not protected(v)), None) if len(queue) == limit else None
                if victim is not None:
                    dropped.append(queue.pop(victim)[0])
                else:
                    keep = protected(value)
            (queue.append((value, now)) if keep else dropped.append(value))
            steps.append({"do": "enqueue", "v": value, "t_ms": now})
            value += 1
        elif dice < 0.9:
            at, gives = now + R.randint(0, 12), None
            while queue:
                v, t = queue.pop(0)
                if v != "<closing>" and at - t > latency and not protected(v):
                    dropped.append(v)
                    continue
                gives = v
                break
            steps.append({"do": "dequeue", "now_ms": at, "gives": gives})
        elif not closed:
            closed, at = True, now - R.randint(-2, 6)
            while queue and queue[0][1] > at:
                dropped.append(queue.pop(0)[0])
            queue.append(("<closing>", at))
            steps.append({"do": "enqueue_closing", "t_ms": at})
        else:
            continue
        steps[-1]["queue_after"] = [v for v, _ in queue]
    return build_case(f"model-queue-{i}", "delivery_queue", {"policy": policy}, [], {"steps": steps, "dropped": dropped})


def random_interval():
    ends = sorted([R.randint(0, 12), R.randint(0, 12)])
    ends[1] += ends[0] == ends[1]
    flags = [R.random() < 0.5, R.random() < 0.5]
    # An unbounded end is never inclusive.
    for side in (0, 1):
        if R.random() < 0.15:
            ends[side], flags[side] = (float("-inf"), float("inf"))[side], False
    return ends, flags


def format_interval(ends, flags):
    shown = ["inf" if abs(e) == float("inf") else str(e) for e in ends]
    return "([" [flags[0]] + ",".join(shown) + ")]"[flags[1]]


def contains_point(ends, flags, point):
    left = ends[0] <= point if flags[0] else ends[0] < point
    return left and (point <= ends[1] if flags[1] else point < ends[1])


def sample_points(ends, flags):
    """Returns the multiples of 1/4 in an interval. Its ends are integers, so the quarters represent the points between."""
    return {q / 4 for q in range(-200, 201) if contains_point(ends, flags, q / 4)}


def interval_case(i):
    (a, fa), (b, fb) = random_interval(), random_interval()
    pa, pb = sample_points(a, fa), sample_points(b, fb)
    kind = R.choice(["contains_point", "intersects", "subset", "translate", "scale"])
    if kind == "contains_point":
        p = R.randint(-1, 14)
        params, expect = {"interval": format_interval(a, fa), "point": p}, {"within": contains_point(a, fa, p)}
    elif kind == "intersects":
        common = bool(pa & pb)
        params = {"a": format_interval(a, fa), "b": format_interval(b, fb)}
        expect = {"intersects": common, "disjoint": not common, "symmetric": True}
    elif kind == "subset":
        params = {"b": format_interval(b, fb), "of": format_interval(a, fa)}
        expect = {"subset": pb <= pa, "proper_subset": pb < pa}
    elif kind == "translate":
        by = R.randint(-9, 9)
        params, expect = {"interval": format_interval(a, fa), "by": by}, {"interval": format_moved([e + by for e in a], fa)}
    else:
        left, right = R.randint(-5, 5), R.randint(-5, 5)
        params = {"interval": format_interval(a, fa), "left_span": left, "right_span": right}
        expect = {"interval": format_moved([a[0] - left, a[1] + right], fa)}
    return build_case(f"model-interval-{i}", "interval." + kind, params, [], expect)


def format_moved(ends, flags):
    return format_interval(ends, flags).replace("(inf", "(-inf")


def build_streams(inputs, keep_open=False):
    extra = {"keep_open": True} if keep_open else {}
    return [{"stream": f"s{k}", "messages": s, **extra} for k, s in enumerate(inputs)]


def build_case(id, op, params, inputs, expect):
    return {"id": id, "op": op, "params": params, "inputs": inputs, "expect": expect, "asserts": "model"}


AREAS = [interpolation_case, fusion_case, pair_case, zip_case, index_window_case, time_window_case, sampling_case, queue_case, interval_case]

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cases", type=int, default=25)
    options = parser.parse_args()
    R = random.Random(options.seed)
    lines = ",\n".join("  " + json.dumps(area(i)) for area in AREAS for i in range(options.cases))
    note = f"test/conformance/model.py --seed {options.seed} --cases {options.cases}"
    print(f'{{"area": "cases of a model",\n "conventions": ["Made by {note}."],\n "cases": [\n{lines}\n]}}')
