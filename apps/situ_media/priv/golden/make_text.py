"""Makes the golden image of text: HarfBuzz positions the glyphs, and FreeType draws them without hinting.

    pip install numpy pillow freetype-py uharfbuzz fonttools
    python make_text.py            # writes text.png to its own folder
"""
import os

import freetype
import numpy as np
import uharfbuzz as hb
from PIL import Image
from fontTools.ttLib import TTFont

HERE = os.path.dirname(os.path.abspath(__file__))
SANS = os.path.join(HERE, "../fonts/DejaVuSans.ttf")
CJK = os.path.join(HERE, "../../test/fixtures/cjk.ttf")

# Font, top left corner of the capitals, height of a capital, text. Each line has one font, script and direction.
LINES = [
    (SANS, 10, 8, 16, "Grüße, Ångström, façade, fi"),
    (SANS, 10.5, 36.25, 16, "Ελληνικά"),
    (SANS, 130, 36, 16, "Кириллица"),
    (SANS, 270, 36, 16, "AVATAR, Tő"),
    (SANS, 10, 64, 20, "שלום עולם"),
    (SANS, 160, 64, 20, "السلام عليكم"),
    (SANS, 10, 100, 9, "small: The quick brown fox jumps over the lazy dog"),
    (SANS, 10, 120, 24, "e\u0301 a\u0308 \u0e01\u0e34"),
    (CJK, 150, 116, 20, "日本語中文字写真映像"),
]


def draw_text(image, path, x, y, size, text):
    font = hb.Font(hb.Face(hb.Blob.from_file_path(path)))
    buffer = hb.Buffer()
    buffer.add_str(text)
    buffer.guess_segment_properties()
    hb.shape(font, buffer)
    face = freetype.Face(path)
    capital = capital_height(path, face)
    ppem = size / capital * face.units_per_EM
    face.set_char_size(round(ppem * 64))
    scale = ppem / face.units_per_EM
    baseline = y + size
    for info, place in zip(buffer.glyph_infos, buffer.glyph_positions):
        left, top = x + place.x_offset * scale, baseline - place.y_offset * scale
        draw_glyph(image, face, info.codepoint, left, top)
        x += place.x_advance * scale


def capital_height(path, face):
    """Returns the height in font units: stated by the font, measured from its H, or a usual value."""
    stated = getattr(TTFont(path)["OS/2"], "sCapHeight", 0)
    if 0.3 <= stated / face.units_per_EM <= 1.2:
        return stated
    if not face.get_char_index("H"):
        return 0.7 * face.units_per_EM
    face.load_char("H", freetype.FT_LOAD_NO_SCALE)
    return face.glyph.outline.get_bbox().yMax


def draw_glyph(image, face, glyph, left, top):
    place = freetype.Vector(round((left % 1) * 64), round((-top % 1) * 64))
    face.set_transform(freetype.Matrix(0x10000, 0, 0, 0x10000), place)
    face.load_glyph(glyph, freetype.FT_LOAD_RENDER | freetype.FT_LOAD_NO_HINTING | freetype.FT_LOAD_NO_BITMAP)
    bitmap = face.glyph.bitmap
    if not bitmap.rows:
        return
    ink = np.array(bitmap.buffer, np.float64).reshape(bitmap.rows, bitmap.pitch)[:, : bitmap.width] / 255
    column = int(np.floor(left)) + face.glyph.bitmap_left
    row = -int(np.floor(-top)) - face.glyph.bitmap_top
    part = image[row : row + bitmap.rows, column : column + bitmap.width]
    part[:] = part * (1 - ink) + 255 * ink


if __name__ == "__main__":
    image = np.zeros((160, 440))
    for line in LINES:
        draw_text(image, *line)
    Image.fromarray(np.round(image).astype(np.uint8)).save(os.path.join(HERE, "text.png"), optimize=True)
