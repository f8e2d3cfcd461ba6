"""Files that are something else than their suffix says, told by how they begin."""

from __future__ import annotations

_STARTS = (
    (b"version https://git-lfs", "is the pointer that Git LFS leaves in place of a file: fetch it with git lfs pull"),
    (b"Kaydara FBX", "is an FBX file: import it into Blender and export it as BVH"),
    (b"; FBX", "is an FBX file: import it into Blender and export it as BVH"),
    (b"glTF", "is a glTF file: import it into Blender and export it as BVH"),
    (b"HIERARCHY", "is a BVH file: name it .bvh"),
    (b":ASF", "is the skeleton of an ASF/AMC pair: convert it to BVH"),
    (b":FULLY-SPECIFIED", "is the motion of an ASF/AMC pair: convert it to BVH"),
    (b"\x89HDF", "is an HDF5 file: save what is in it as .npz"),
    (b"MATLAB 5.0", "is a MATLAB file: save what is in it as .npz"),
    (b"<", "is XML or a web page, as a download that failed leaves one"),
    (b"Rar!", "is an archive: unpack it first"),
    (b"7z\xbc\xaf", "is an archive: unpack it first"),
)


def foreign_start(start: bytes) -> str:
    """What a file that begins so is, as a half sentence whose subject is the file (`is an FBX file: ...`); `` for what
    is not known."""
    start = start.lstrip(b"\xef\xbb\xbf \t\r\n")
    known = next((what for mark, what in _STARTS if start[: len(mark)].upper() == mark.upper()), "")
    return known or ("is a video: track the person with a pose estimator" if start[4:8] == b"ftyp" else "")
