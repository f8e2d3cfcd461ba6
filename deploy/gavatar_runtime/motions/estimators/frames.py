"""Files that hold a video frame by frame, with the persons of each: PHALP and 4D-Humans, ROMP, EasyMocap, folders."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from ..field_reader import as_array
from .found import CAMERA, Found, by_person, natural, sorted_items
from .layouts import layout_of, people_by

UNTRACKED = "the file does not follow persons: a number is the place in each frame's list"
IN_PLACE = "its camera has a made-up focal length, so that the person stays in place"

Frame = list[tuple[Hashable, dict[str, Any]]]  # label and fields of each person


def phalp(content: Any) -> Found | None:
    """PHALP and 4D-Humans: a dictionary a frame, with lists of persons: `tid`, and `smpl` of rotation matrices."""
    if not isinstance(content, dict) or not content:
        return None
    frames = [f for f in content.values() if isinstance(f, dict) and isinstance(f.get("smpl"), (list, tuple))]
    if not frames or len(frames) < 0.5 * len(content):
        return None
    if all(type(frame.get("time")) is int for frame in frames):
        frames.sort(key=lambda frame: frame["time"])
    else:
        frames = [f for _, f in sorted_items(content) if any(f is frame for frame in frames)]
    return Found("PHALP or 4D-Humans", by_person([_phalp_frame(frame) for frame in frames]), notes=(IN_PLACE,))


def _phalp_frame(frame: dict[str, Any]) -> Frame:
    """The persons that were seen in the frame; those of whom it only holds what was seen before are left out."""
    bodies, ids, ages = (list(frame.get(key) or ()) for key in ("smpl", "tid", "tracked_time"))
    ids = ids if len(ids) == len(bodies) else list(range(len(bodies)))
    ages = ages if len(ages) == len(bodies) else [0] * len(bodies)
    return [(i, body) for i, body, age in zip(ids, bodies, ages, strict=True) if isinstance(body, dict) and not age]


def romp(content: Any) -> Found | None:
    """ROMP: `sequence_results` by person, or `results` by frame, or `results` of one image."""
    if not isinstance(content, dict):
        return None
    sequences = content.get("sequence_results")
    if isinstance(sequences, dict) and sequences and all(isinstance(s, dict) for s in sequences.values()):
        return merged([people_by(layout, s, str(i)) for i, s in sorted_items(sequences) if (layout := layout_of(s))])
    results = content.get("results")
    if isinstance(results, dict) and "smpl_thetas" in results:
        frames = [_romp_frame(results)]
    elif isinstance(results, dict):
        frames = [_romp_frame(frame) for _, frame in sorted_items(results)]
    else:
        return None
    if not any(frames):
        return None
    tracked = all("track_ids" in f for f in ([results] if "smpl_thetas" in results else results.values()) if len(f))
    found = stacked(frames)
    if found is None:
        return None
    found.notes += () if tracked or len(found.people) < 2 else (UNTRACKED,)
    return found


def _romp_frame(frame: Any) -> Frame:
    if isinstance(frame, (list, tuple)):
        return [(i, person) for i, person in enumerate(frame) if isinstance(person, dict)]
    if not isinstance(frame, dict) or (thetas := as_array(frame.get("smpl_thetas"))) is None or thetas.ndim != 2:
        return []
    every = {key: as_array(value) for key, value in frame.items()}
    arrays = {key: a for key, a in every.items() if a is not None and a.ndim and len(a) == len(thetas)}
    ids: Any = arrays.pop("track_ids", range(len(thetas)))
    return [(int(ids[i]), {key: a[i] for key, a in arrays.items()}) for i in range(len(thetas))]


def stacked(frames: list[Frame]) -> Found | None:
    """The persons of a row of frames, by the layout that their fields then have."""
    found = []
    for person in by_person(frames):
        layout = layout_of(person.fields)
        if layout is not None:
            one = people_by(layout, person.fields, person.label)
            one.people[0].frames = person.frames
            found.append(one)
    return merged(found)


def merged(found: list[Found]) -> Found | None:
    """One for all, with the tool of the first."""
    if not found:
        return None
    notes = tuple(dict.fromkeys(note for one in found for note in one.notes))
    return Found(found[0].tool, [person for one in found for person in one.people], found[0].fps, notes)


def collection(entries: list[tuple[Hashable, Any]]) -> Found | None:
    """Persons by label, or frames in order, of a dictionary or a list of them.

    Entries of one frame each are frames, but where they name different persons (`id`); lists of dictionaries are the
    persons of a frame.
    """
    entries = [(label, _without_wrapper(value)) for label, value in entries]
    frames = [value for _, value in sorted(entries, key=lambda e: natural(e[0])) if _is_frame(value)]
    if frames and len(frames) >= 0.5 * len(entries):
        return stacked([[(_id(person, i), person) for i, person in enumerate(frame)] for frame in frames])
    people = [(label, value, layout) for label, value in entries if (layout := layout_of(value)) is not None]
    if not people:
        return None
    ids = [value.get("id") for _, value, _ in people]
    found = [people_by(layout, value, str(label)) for label, value, layout in people]
    if len(people) == 1 or any(len(person) != 1 for one in found for person in one.people):
        return merged(found)
    if None not in ids and len({str(i) for i in ids}) == len(ids):
        return stacked([[(i, value) for i, (_, value, _) in zip(ids, people, strict=True)]])
    people.sort(key=lambda entry: natural(entry[0]))
    return stacked([[(_id(value, 0), value)] for _, value, _ in people])


def _without_wrapper(value: Any) -> Any:
    """The list in `{"annots": [...]}` and the like."""
    if isinstance(value, dict) and layout_of(value) is None:
        return next((value[key] for key in ("annots", "smpl", "persons", "people", "results") if key in value), value)
    return value


def _is_frame(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and all(layout_of(person) is not None for person in value)


def _id(person: dict[str, Any], place: int) -> Hashable:
    label = person.get("id", place)
    return label if isinstance(label, (int, str)) else place


__all__ = ["CAMERA", "collection", "merged", "phalp", "romp", "stacked"]
