"""Reads Situ's annotation files with independent programs, and writes their files for Situ to read."""
import csv, json, os, sys

import pympi, pysrt, textgrid, webvtt
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from praatio import textgrid as praatio
from praatio.utilities.constants import Interval
from sklearn.metrics import cohen_kappa_score

root = sys.argv[1]
file_path = lambda name: os.path.join(root, name)
anna = {("P1", 500, 1500, "speaks"), ("P1", 1500, 2250, "laughs"), ("Zoë & co", 700, 3001, "speaks")}
to_ms = lambda seconds: round(float(seconds) * 1000)
failures = []


def check_equal(name, got, wanted=anna):
    print(f"{name}: {'equal' if got == wanted else 'DIFFERS'}")
    if got != wanted:
        failures.append(f"{name}: {sorted(got)} is not {sorted(wanted)}")


eaf = pympi.Elan.Eaf(file_path("anna.eaf"))
check_equal("pympi", {(t, a[0], a[1], a[2]) for t in eaf.get_tier_names() for a in eaf.get_annotation_data_for_tier(t)})
words = {d[0][0][0] for d in eaf.get_cv_entries("Speech").values()} if "Speech" in eaf.get_controlled_vocabulary_names() else set()
check_equal("pympi, controlled vocabulary", words, {"speaks", "laughs"})

# Tiers that depend on each other. pympi writes them again, without the header of Situ.
tiers = pympi.Elan.Eaf(file_path("tiers.eaf"))
parents = {t: tiers.tiers[t][2].get("PARENT_REF") for t in tiers.get_tier_names()}
kinds = {t: tiers.linguistic_types[tiers.tiers[t][2]["LINGUISTIC_TYPE_REF"]].get("CONSTRAINTS") for t in parents}
check_equal("pympi, parents", {(t.split("@")[0], (p or "").split("@")[0], kinds[t]) for t, p in parents.items()}, {
    ("Utterance", "", None), ("Words", "Utterance", "Included_In"), ("Turns", "Utterance", "Time_Subdivision"),
    ("Parts", "Words", "Symbolic_Subdivision"), ("Kind", "Parts", "Symbolic_Association")})
data = {t: [tuple(a[:3]) for a in tiers.get_annotation_data_for_tier(t)] for t in parents if kinds[t] in (
    None, "Included_In", "Time_Subdivision")}
# pympi finds the times of references to aligned annotations only, so references are compared as they are.
refs = {t: list(tiers.tiers[t][1].items()) for t in parents}
words = {value: n for t in parents for n, (_, _, value, _) in tiers.tiers[t][0].items()}
(co, (co_parent, _, co_before, _)), (me, (me_parent, _, me_before, _)) = refs["Parts@Ada"]
check_equal("pympi, references", (co_parent, co_before, me_parent, me_before, refs["Kind@Ada"][0][1][0]),
            (words["come"], None, words["come"], co, me))
check_equal("pympi, aligned tiers", (data["Turns@Ada"], data["Words@Ada"]), (
    [(1000, 2000, "first"), (2000, 3000, "second")], [(1100, 1500, "come"), (1600, 2200, "here")]))
check_equal("pympi, symbolic tiers", ([a[1][1] for a in refs["Parts@Ada"]], [a[1][1] for a in refs["Kind@Ada"]]),
            (["co", "me"], ["hand"]))
check_equal("pympi, participants", {tiers.tiers[t][2].get("PARTICIPANT") for t in parents}, {"Ada", "Ben"})
# Situ's times are the same if the file names no origin.
tiers.properties = [p for p in tiers.properties if p[0] != "situ.schema"]
tiers.to_file(file_path("tiers2.eaf"))

grid = textgrid.TextGrid.fromFile(file_path("anna.TextGrid"))
check_equal("textgrid", {(t.name, to_ms(i.minTime), to_ms(i.maxTime), i.mark) for t in grid for i in t if i.mark})
grid = praatio.openTextgrid(file_path("anna.TextGrid"), includeEmptyIntervals=False)
check_equal("praatio", {(n, to_ms(e.start), to_ms(e.end), e.label) for n in grid.tierNames for e in grid.getTier(n).entries})

def parse_clock(text):
    h, m, s = text.split(":")
    return to_ms(int(h) * 3600 + int(m) * 60 + float(s))


cues = webvtt.read(file_path("anna.vtt"))
check_equal("webvtt-py", {(c.voice.replace("&amp;", "&"), parse_clock(c.start), parse_clock(c.end), c.text) for c in cues})
subs = pysrt.open(file_path("anna.srt"), encoding="utf-8")
check_equal("pysrt", {(s.text[1:].split("] ")[0], s.start.ordinal, s.end.ordinal, s.text.split("] ")[1]) for s in subs})
with open(file_path("anna.csv"), newline="", encoding="utf-8") as file:
    check_equal("csv", {(r["track"], to_ms(r["from_s"]), to_ms(r["to_s"]), r["Speech"]) for r in csv.DictReader(file)})

# Reads boxes like a training program of detectors.
coco = COCO(file_path("boxes.coco.json"))
names = {c["id"]: c["name"] for c in coco.loadCats(coco.getCatIds())}
boxes = {(coco.loadImgs(a["image_id"])[0]["time_ns"] // 10**6 % 10**6, names[a["category_id"]], *a["bbox"], a["area"])
         for a in coco.loadAnns(coco.getAnnIds(iscrowd=False))}
check_equal("pycocotools", boxes, {(0, "face", 10, 20, 30.5, 40, 1220), (100, "face", 20, 40, 30.5, 60, 1830),
                             (50, "hand", 1, 2, 3, 4, 12)})
every = COCO(file_path("every.coco.json"))
faces = every.loadAnns(every.getAnnIds(catIds=every.getCatIds(catNms=["face"])))
check_equal("pycocotools, every image", {tuple(a["bbox"]) for a in faces},
      {(10 + 2.5 * n, 20 + 5 * n, 30.5, 40 + 5 * n) for n in range(5)})
scores = COCOeval(coco, coco.loadRes([{**a, "score": 1.0} for a in coco.loadAnns(coco.getAnnIds())]), "bbox")
scores.evaluate(), scores.accumulate(), scores.summarize()
check_equal("pycocotools, average precision of the truth", round(float(scores.stats[0]), 6), 1.0)

# Kappa of 10 ms frames over the same span, computed by scikit-learn.
ben = {("P1", 610, 1480, "speaks"), ("P1", 1500, 2500, "speaks"), ("Zoë & co", 700, 2800, "speaks")}
label_at = lambda spans, track, t: next((v for n, a, b, v in spans if n == track and a <= t < b), "none")
times = [500 + 10 * k + 5 for k in range((3001 - 500) // 10)]
pairs = [(label_at(anna, t, x), label_at(ben, t, x)) for t in ("P1", "Zoë & co") for x in times]
kappa = cohen_kappa_score([a for a, _ in pairs], [b for _, b in pairs])
report = json.load(open(file_path("agreement.json")))
close = abs(kappa - report["kappa"]) < 1e-12 and len(pairs) == report["frames"]
print(f"scikit-learn: kappa {kappa:.6f}, situ: {report['kappa']:.6f}, {report['frames']} frames")
if not close:
    failures.append("kappa differs from scikit-learn's")

# Files that Situ imports.
other = pympi.Elan.Eaf(author="x")
other.remove_tier("default")
other.add_tier("P1")
other.add_annotation("P1", 500, 1500, "speaks")
other.add_annotation("P1", 1500, 2250, "laughs")
other.to_file(file_path("elan.eaf"))
grid = praatio.Textgrid()
grid.addTier(praatio.IntervalTier("P1", [Interval(0.5, 1.5, "speaks"), Interval(1.5, 2.25, "laughs")], 0, 4))
grid.save(file_path("praat.TextGrid"), format="short_textgrid", includeBlankSpaces=True)
vtt = webvtt.WebVTT()
vtt.captions.append(webvtt.Caption("00:00:00.500", "00:00:01.500", "speaks"))
vtt.captions.append(webvtt.Caption("00:00:01.500", "00:00:02.250", "laughs"))
vtt.save(file_path("other.vtt"))
srt = pysrt.SubRipFile(items=[
    pysrt.SubRipItem(1, pysrt.SubRipTime(milliseconds=500), pysrt.SubRipTime(milliseconds=1500), "speaks"),
    pysrt.SubRipItem(2, pysrt.SubRipTime(milliseconds=1500), pysrt.SubRipTime(milliseconds=2250), "laughs")])
srt.save(file_path("other.srt"), encoding="utf-8")

json.dump({"images": [{"id": 7, "file_name": "7.jpg", "width": 64, "height": 48}],
           "categories": [{"id": 3, "name": "hand"}],
           "annotations": [{"id": 1, "image_id": 7, "category_id": 3, "bbox": [11.5, 2, 3, 4], "area": 12, "iscrowd": 0}]},
          open(file_path("other.coco.json"), "w"))

for failure in failures:
    print(failure)
sys.exit(1 if failures else 0)
