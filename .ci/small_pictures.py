"""Small pictures of README and of the index pages, cut from those of the studies: python3 .ci/small_pictures.py.

All have one size. They show what a picture shows, the meshed layer first, without its titles and colour bar.
"""

from pathlib import Path

from PIL import Image, ImageChops

CLONE = Path(__file__).parents[1]
SMALL = CLONE / "thinlayer/docs/_static"
SIZE, MARGIN = (440, 280), 8  # twice as many pixels as a page shows, for screens that are fine
LEFT_RIGHT = ((0.0, 0.5), (0.5, 1.0))
# what is cut: parts of the width that are drawn beside or below each other, and the part of the height
CUTS = {
    "butt_joint": ("rates_butt_joint.png", LEFT_RIGHT, (0.11, 0.87), "beside"),
    "wall": ("wall.png", LEFT_RIGHT, (0.11, 0.7), "below"),
    "grains": ("junctions_grains.png", LEFT_RIGHT, (0.14, 0.85), "beside"),
    "arch": ("rates_own_mesh.png", LEFT_RIGHT, (0.24, 0.73), "below"),
    "lap": ("lap.png", LEFT_RIGHT, (0.14, 0.67), "below"),
    "fibre": ("rates_fibre.png", LEFT_RIGHT, (0.16, 0.85), "beside"),
    "end": ("fig6_stratified_end.png", LEFT_RIGHT, (0.16, 0.8), "beside"),
    "zoom": ("zoom.png", ((0.09, 0.83),), (0.045, 0.262), "beside"),
}


def cut(name: str) -> Image.Image:
    """The small picture of this name."""
    file, columns, (top, bottom), where = CUTS[name]
    with Image.open(CLONE / "studies/pictures" / file) as picture:
        whole = picture.convert("RGB")
    w, h = whole.size
    parts = [whole.crop((int(a * w), int(top * h), int(b * w), int(bottom * h))) for a, b in columns]
    parts = [part.crop(ImageChops.invert(part.convert("L")).getbbox()) for part in parts]
    beside = where == "beside"
    each = [SIZE[k] // (len(parts) if beside == (k == 0) else 1) - 2 * MARGIN for k in (0, 1)]
    scale = min(side / part.size[k] for part in parts for k, side in enumerate(each))  # one for both
    small = Image.new("RGB", SIZE, "white")
    for i, part in enumerate(parts):
        drawn = part.resize([max(round(scale * side), 1) for side in part.size], Image.Resampling.LANCZOS)
        cell = [SIZE[k] // (len(parts) if beside == (k == 0) else 1) for k in (0, 1)]
        corner = [cell[k] * i * (beside == (k == 0)) + (cell[k] - drawn.size[k]) // 2 for k in (0, 1)]
        small.paste(drawn, tuple(corner))
    return small


if __name__ == "__main__":
    for name in CUTS:
        cut(name).quantize(256).save(SMALL / f"{name}.png", optimize=True)
