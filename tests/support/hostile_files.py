# SPDX-License-Identifier: GPL-3.0-or-later
"""VRTs that are attacks, and damaged files of every kind, for tests."""

import os
from xml.sax.saxutils import escape

import numpy as np
from rasters import hills, write_exr, write_raster

PART = "part.tif"


def vrt(inside: str, more: str = "", of_set: str = "") -> str:
    """Return a VRT of 65 x 33 samples with one band; `more`, `of_set`: attributes of the band and of the file."""
    return (
        f'<VRTDataset rasterXSize="65" rasterYSize="33"{of_set}>'
        f'<VRTRasterBand dataType="Float32" band="1"{more}>{inside}</VRTRasterBand></VRTDataset>'
    )


def source(name: str, relative: int = 1, kind: str = "SimpleSource", more: str = "") -> str:
    return (
        f'<{kind}><SourceFilename relativeToVRT="{relative}">{escape(name)}</SourceFilename>'
        f"<SourceBand>1</SourceBand>{more}</{kind}>"
    )


def subclass(name: str) -> str:
    return f' subClass="{name}"'


def attacks(folder, port: int) -> dict:
    """Return VRTs by name, each with a part of the sentence that refuses it.

    An attack that succeeds writes into `folder` / "out" or requests from the server at `port`.
    """
    address = f"http://127.0.0.1:{port}/a.tif"
    service = (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>file://{folder}/served/${{z}}</ServerUrl></Service><DataWindow>'
        "<UpperLeftX>0</UpperLeftX><UpperLeftY>33</UpperLeftY><LowerRightX>65</LowerRightX><LowerRightY>0</LowerRightY>"
        "<TileLevel>0</TileLevel><SizeX>65</SizeX><SizeY>33</SizeY></DataWindow><BandsCount>1</BandsCount>"
        f"<Cache><Path>{folder}/out</Path><Extension>.py</Extension></Cache></GDAL_WMS>"
    )
    raw = "<ImageOffset>0</ImageOffset><PixelOffset>4</PixelOffset><LineOffset>260</LineOffset>"
    named = f'<SourceFilename relativeToVRT="0">{folder}/secret.txt</SourceFilename>{raw}'
    python = "<PixelFunctionLanguage>Python</PixelFunctionLanguage><PixelFunctionType>f</PixelFunctionType>"
    no_file = "is no regular file here"
    networks = [f"/vsicurl/{address}", address, "/vsis3/bucket/a.tif", f"WMTS:{address}", f"vrt://{address}"]
    networks += [f'NETCDF:"{address}":a', f"ZARR:/vsicurl/{address}", f"/vsizip/vsicurl/{address}"]
    networks += [f"/vsicurl_streaming/{address}"]
    nested = escape(vrt(source(address, 0)))
    return {
        "service": (vrt(source(service, 0)), no_file),
        **{f"network{i}": (vrt(source(name, 0)), no_file) for i, name in enumerate(networks)},
        "inline": (vrt(f"<SimpleSource><SourceFilename>{nested}</SourceFilename></SimpleSource>"), no_file),
        "virtual": (vrt(source("/vsistdin/", 0)), no_file),
        "mask": (vrt(source(PART) + f"<MaskBand>{vrt(source(address, 0))}</MaskBand>"), "<VRTDataset> where none"),
        "raw": (vrt(named, subclass("VRTRawRasterBand")), 'subClass="VRTRawRasterBand"'),
        "raw_alone": (vrt(named), "<SourceFilename> where none is expected"),
        "python": (vrt(source(PART) + python, subclass("VRTDerivedRasterBand")), "VRTDerivedRasterBand"),
        "warped": (vrt(source(PART), of_set=subclass("VRTWarpedDataset")), "VRTWarpedDataset"),
        "options": (vrt(source(PART, more='<OpenOptions><OOI key="A">b</OOI></OpenOptions>')), "<OpenOptions>"),
        "array": (vrt("<ArraySource/>"), "<ArraySource> where none"),
        "fifo": (vrt(source("pipe.tif")), no_file),
        "folder": (vrt(source(".")), no_file),
        "gone": (vrt(source("gone.tif")), no_file),
        "text": (vrt(source("secret.txt")), "expected one of .asc, .hgt"),
        "liar": (vrt(source("liar.tif")), "holds XML"),
        "itself": (vrt(source("itself.vrt")), "contains itself"),
        "twelve0": (vrt(source("twelve1.vrt") * 9), "more than 3 deep"),
        "entities": ('<!DOCTYPE a [<!ENTITY b "cc">]>' + vrt(source("&b;")), "a document type"),
        "external": ('<!DOCTYPE a SYSTEM "file:///etc/passwd">' + vrt(source(PART)), "a document type"),
        "tags": ("<VRTDataset>" * 30_000, "where none is expected"),
        "ignored": (vrt("<Metadata>" * 30_000), "more than 16 deep"),
        "names": ("<SourceFilename" * 30_000, "no well-formed XML"),
        "rectangle": (
            vrt(source(PART, more='<SrcRect xOff="1e300" yOff="0" xSize="1" ySize="1"/>')),
            "'1e300' for xOff",
        ),
        "reference": (vrt("").replace("<VRTR", f"<SRS>{address}</SRS><VRTR"), "for SRS"),
        "bytes": ("\0\1<VRTDataset", "no well-formed XML"),
        "empty": (" ", "no well-formed XML"),
    }


def write_attacks(folder, port: int) -> dict[str, str]:
    """Write all of `attacks` and what they name into `folder`; returns what refuses each, by the file's name."""
    write_raster(folder / PART, hills(65, 33))
    os.mkfifo(folder / "pipe.tif")
    (folder / "served").mkdir()
    write_raster(folder / "served" / "0", hills(65, 33), driver="GTiff")
    (folder / "secret.txt").write_bytes(bytes(65 * 33 * 4))
    (folder / "liar.tif").write_text("\n" + vrt(source(f"http://127.0.0.1:{port}/a.tif", 0)))
    for i in range(1, 13):
        (folder / f"twelve{i}.vrt").write_text(vrt(source(f"twelve{i + 1}.vrt" if i < 12 else PART) * 9))
    expected = {}
    for name, (text, said) in attacks(folder, port).items():
        (folder / f"{name}.vrt").write_text(text)
        expected[f"{name}.vrt"] = said
    return expected


def seeds(folder) -> list:
    """Small good files of every kind, from which damaged ones are made."""
    heights, whole = hills(33, 17), hills(33, 17).astype(np.uint16)
    place = {"crs": "EPSG:32616", "transform": (30.0, 0.0, 5e5, 0.0, -30.0, 4e6)}
    paths = [
        write_raster(folder / "tiles.tif", heights, tiled=True, blockxsize=16, blockysize=16, compress="lzw", **place),
        write_raster(folder / "strips.tif", whole, compress="deflate", predictor=2, blockysize=5, nodata=300),
        write_raster(folder / "grey.png", whole),
        write_raster(folder / "grid.asc", heights),
        write_exr(folder / "zip.exr", Y=heights),
        folder / "plain.npy",
        folder / "mosaic.vrt",
    ]
    np.save(paths[-2], heights)
    paths[-1].write_text(vrt(source("strips.tif", kind="ComplexSource", more="<NODATA>3</NODATA>")))
    return paths


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """Change, delete, repeat or maximise a few bytes, most of them in the header."""
    data = bytearray(content)
    for _ in range(random.integers(1, 6)):
        end = len(data) if random.random() < 0.4 else min(len(data), 512)
        at, size = int(random.integers(0, max(end, 1))), int(random.integers(1, 9))
        kind = random.integers(0, 4)
        if kind == 0:
            data[at : at + size] = random.integers(0, 256, size, np.uint8).tobytes()
        elif kind == 1:
            del data[at : at + size]
        elif kind == 2:
            data[at:at] = data[at : at + size] * int(random.integers(1, 300))
        else:
            extreme = [0, 1, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 0x10000000][random.integers(0, 7)]
            data[at : at + 4] = extreme.to_bytes(4, "little" if random.random() < 0.7 else "big")
    return bytes(data)
