"""Pictures on disk: channels, exposure, and that nothing half-written is left."""

import os

import mitsuba as mi
import numpy as np
import pytest

from mitsuba_refscatter import image_io


def render_box(pixel_format="rgb"):
    box = mi.cornell_box()
    box["sensor"]["film"].update(width=16, height=16, pixel_format=pixel_format, component_format="float32")
    box["integrator"] = {"type": "aov", "aovs": "depth:depth", "image": {"type": "direct"}}
    scene = mi.load_dict(box)
    mi.render(scene, spp=4)
    return scene.sensors()[0].film().bitmap()


def channels(bitmap):
    names = [field.name for field in bitmap.struct_()]
    return dict(zip(names, np.moveaxis(np.array(bitmap), -1, 0)))


def test_every_channel_is_written_with_its_name(variant, tmp_path):
    bitmap = render_box()
    exr, png = image_io.write_image(tmp_path / "picture.exr", bitmap)
    read = mi.Bitmap(str(exr))
    before, after = (channels(b) for b in (bitmap, read))
    assert "depth.T" in before and ("Y" if "mono" in variant else "R") in before
    assert before.keys() == after.keys()  # OpenEXR sorts them
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert np.array(mi.Bitmap(str(png))).shape == (16, 16, 3)
    assert sorted(os.listdir(tmp_path)) == ["picture.exr", "picture.png"]


@pytest.mark.parametrize("pixel_format", ["luminance", "luminance_alpha", "rgba", "xyz", "xyza"])
def test_every_film_format_gets_a_png(rgb, pixel_format, tmp_path):
    exr, png = image_io.write_image(tmp_path / "picture", render_box(pixel_format))
    assert exr.name == "picture.exr" and png is not None and png.exists()
    # The box is mostly lit: a wrong conversion (alpha or luminance as a colour) would be black or flat.
    assert np.array(mi.Bitmap(str(png))).std() > 10


def test_exposure_follows_the_lit_pixels_only():
    image = np.zeros((100, 100, 3))
    image[:10] = 4.0
    assert image_io.exposure(image) == pytest.approx(0.2)
    image[0, 0], image[50, 50] = np.inf, np.nan
    assert image_io.exposure(image) == pytest.approx(0.2)
    # One firefly in a thousand pixels must not darken the picture.
    image[1, 1] = 1e6
    assert image_io.exposure(image) == pytest.approx(0.2)


def test_tone_mapping_of_hard_images():
    assert (image_io.tone_map(np.zeros((4, 4, 3))) == 0).all()
    hard = np.full((4, 4, 3), 0.5)
    hard[0, 0], hard[0, 1], hard[0, 2] = np.nan, np.inf, -1.0
    mapped = image_io.tone_map(hard)
    # 0.8 linear is 230.8 of 255 in sRGB.
    assert (mapped[0, :3] == 0).all() and (mapped[1:] == 231).all()


def test_a_failing_write_leaves_the_earlier_picture(rgb, tmp_path):
    path = tmp_path / "picture.exr"
    image_io.write_image(path, np.ones((4, 4, 3)))
    before = path.read_bytes()

    class Broken:
        def write(self, name):
            with open(name, "wb") as file:
                file.write(b"half")
            raise RuntimeError("disk full")

    with pytest.raises(image_io.OutputError, match="disk full"):
        image_io.write_file(path, Broken().write)
    assert path.read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["picture.exr", "picture.png"]


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(image_io.OutputError, match="is a directory"):
        image_io.target(tmp_path)
    with pytest.raises(image_io.OutputError, match="nothing can be written"):
        image_io.target(tmp_path / "file" / "picture.exr")
    with pytest.raises(image_io.OutputError, match="end in .exr"):
        image_io.target(tmp_path / "picture.jpg")
    assert image_io.target(tmp_path / "new" / "picture").name == "picture.exr"
