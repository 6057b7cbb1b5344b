"""Reads what Situ wrote with other people's programs, and writes files of theirs for Situ to read."""
import csv, json, os, sys

import pympi, pysrt, textgrid, webvtt
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from praatio import textgrid as praatio
from praatio.utilities.constants import Interval
from sklearn.metrics import cohen_kappa_score

root = sys.argv[1]
path = lambda name: os.path.join(root, name)
anna = {("P1", 500, 1500, "speaks"), ("P1", 1500, 2250, "laughs"), ("Zoë & co", 700, 3001, "speaks")}
ms = lambda seconds: round(float(seconds) * 1000)
failures = []


def equal(name, got, wanted=anna):
    print(f"{name}: {'as meant' if got == wanted else 'DIFFERS'}")
    if got != wanted:
        failures.append(f"{name}: {sorted(got)} is not {sorted(wanted)}")


eaf = pympi.Elan.Eaf(path("anna.eaf"))
equal("pympi", {(t, a[0], a[1], a[2]) for t in eaf.get_tier_names() for a in eaf.get_annotation_data_for_tier(t)})
words = {d[0][0][0] for d in eaf.get_cv_entries("Speech").values()} if "Speech" in eaf.get_controlled_vocabulary_names() else set()
equal("pympi, controlled vocabulary", words, {"speaks", "laughs"})

grid = textgrid.TextGrid.fromFile(path("anna.TextGrid"))
equal("textgrid", {(t.name, ms(i.minTime), ms(i.maxTime), i.mark) for t in grid for i in t if i.mark})
grid = praatio.openTextgrid(path("anna.TextGrid"), includeEmptyIntervals=False)
equal("praatio", {(n, ms(e.start), ms(e.end), e.label) for n in grid.tierNames for e in grid.getTier(n).entries})

def clock(text):
    h, m, s = text.split(":")
    return ms(int(h) * 3600 + int(m) * 60 + float(s))


cues = webvtt.read(path("anna.vtt"))
equal("webvtt-py", {(c.voice.replace("&amp;", "&"), clock(c.start), clock(c.end), c.text) for c in cues})
subs = pysrt.open(path("anna.srt"), encoding="utf-8")
equal("pysrt", {(s.text[1:].split("] ")[0], s.start.ordinal, s.end.ordinal, s.text.split("] ")[1]) for s in subs})
with open(path("anna.csv"), newline="", encoding="utf-8") as file:
    equal("csv", {(r["track"], ms(r["from_s"]), ms(r["to_s"]), r["Speech"]) for r in csv.DictReader(file)})

# Boxes, as trainers of detectors read them.
coco = COCO(path("boxes.coco.json"))
names = {c["id"]: c["name"] for c in coco.loadCats(coco.getCatIds())}
boxes = {(coco.loadImgs(a["image_id"])[0]["time_ns"] // 10**6 % 10**6, names[a["category_id"]], *a["bbox"], a["area"])
         for a in coco.loadAnns(coco.getAnnIds(iscrowd=False))}
equal("pycocotools", boxes, {(0, "face", 10, 20, 30.5, 40, 1220), (100, "face", 20, 40, 30.5, 60, 1830),
                             (50, "hand", 1, 2, 3, 4, 12)})
every = COCO(path("every.coco.json"))
faces = every.loadAnns(every.getAnnIds(catIds=every.getCatIds(catNms=["face"])))
equal("pycocotools, every picture", {tuple(a["bbox"]) for a in faces},
      {(10 + 2.5 * n, 20 + 5 * n, 30.5, 40 + 5 * n) for n in range(5)})
scores = COCOeval(coco, coco.loadRes([{**a, "score": 1.0} for a in coco.loadAnns(coco.getAnnIds())]), "bbox")
scores.evaluate(), scores.accumulate(), scores.summarize()
equal("pycocotools, average precision of the truth", round(float(scores.stats[0]), 6), 1.0)

# Kappa of frames of 10 ms, by scikit-learn, over the same span.
ben = {("P1", 610, 1480, "speaks"), ("P1", 1500, 2500, "speaks"), ("Zoë & co", 700, 2800, "speaks")}
label = lambda spans, track, t: next((v for n, a, b, v in spans if n == track and a <= t < b), "none")
times = [500 + 10 * k + 5 for k in range((3001 - 500) // 10)]
pairs = [(label(anna, t, x), label(ben, t, x)) for t in ("P1", "Zoë & co") for x in times]
kappa = cohen_kappa_score([a for a, _ in pairs], [b for _, b in pairs])
report = json.load(open(path("agreement.json")))
close = abs(kappa - report["kappa"]) < 1e-12 and len(pairs) == report["frames"]
print(f"scikit-learn: kappa {kappa:.6f}, situ: {report['kappa']:.6f}, {report['frames']} frames")
if not close:
    failures.append("kappa differs from scikit-learn's")

# Files of theirs.
other = pympi.Elan.Eaf(author="x")
other.remove_tier("default")
other.add_tier("P1")
other.add_annotation("P1", 500, 1500, "speaks")
other.add_annotation("P1", 1500, 2250, "laughs")
other.to_file(path("elan.eaf"))
grid = praatio.Textgrid()
grid.addTier(praatio.IntervalTier("P1", [Interval(0.5, 1.5, "speaks"), Interval(1.5, 2.25, "laughs")], 0, 4))
grid.save(path("praat.TextGrid"), format="short_textgrid", includeBlankSpaces=True)
vtt = webvtt.WebVTT()
vtt.captions.append(webvtt.Caption("00:00:00.500", "00:00:01.500", "speaks"))
vtt.captions.append(webvtt.Caption("00:00:01.500", "00:00:02.250", "laughs"))
vtt.save(path("other.vtt"))
srt = pysrt.SubRipFile(items=[
    pysrt.SubRipItem(1, pysrt.SubRipTime(milliseconds=500), pysrt.SubRipTime(milliseconds=1500), "speaks"),
    pysrt.SubRipItem(2, pysrt.SubRipTime(milliseconds=1500), pysrt.SubRipTime(milliseconds=2250), "laughs")])
srt.save(path("other.srt"), encoding="utf-8")

json.dump({"images": [{"id": 7, "file_name": "7.jpg", "width": 64, "height": 48}],
           "categories": [{"id": 3, "name": "hand"}],
           "annotations": [{"id": 1, "image_id": 7, "category_id": 3, "bbox": [11.5, 2, 3, 4], "area": 12, "iscrowd": 0}]},
          open(path("other.coco.json"), "w"))

for failure in failures:
    print(failure)
sys.exit(1 if failures else 0)
