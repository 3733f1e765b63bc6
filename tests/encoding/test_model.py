"""Checkpoints: the same content gives the same bytes and hash; a hostile or damaged one gets one line, never a run."""

import io
import json
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from semloc_core.encoding.encoder import ENCODERS, build_encoder
from semloc_core.encoding.model import Model
from semloc_core.errors import ModelError
from semloc_core.graph.labels.labelspace import Labelspace

LABELSPACE = Labelspace(
    "office",
    ("chair", "couch", "plant"),
    ids={"chair": (5, 6), "couch": (8,), "plant": (11,)},
    mobility={"chair": 0.8},
    synonyms={"sofa": "couch"},
    default_mobility=0.2,
)


def make(name: str = "paper", **options: Any) -> Model:
    encoder = build_encoder(name, options, 3, torch.Generator().manual_seed(5))
    return Model(encoder, LABELSPACE, seed=7, temperature=0.07, provenance={"graphs": ["a", "b"], "epochs": 3})


def rewritten(change: Callable[[dict[str, bytes]], None], compression: int = zipfile.ZIP_STORED) -> bytes:
    """A model file with its members changed."""
    with zipfile.ZipFile(io.BytesIO(make().to_bytes())) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    change(members)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def with_header(**fields: Any) -> bytes:
    def change(members: dict[str, bytes]) -> None:
        members["header.json"] = json.dumps(json.loads(members["header.json"]) | fields).encode()

    return rewritten(change)


def npy(array: np.ndarray, allow_pickle: bool = False) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=allow_pickle)
    return buffer.getvalue()


def with_tensor(name: str, content: bytes) -> bytes:
    return rewritten(lambda members: members.__setitem__(f"{name}.npy", content))


def refused(data: bytes, match: str, **options: Any) -> None:
    with pytest.raises(ModelError, match=match) as caught:
        Model.from_bytes(data, **options)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_round_trip_keeps_everything(name: str) -> None:
    model = make(name)
    data = model.to_bytes()
    found = Model.from_bytes(data)
    assert found.hash == model.hash
    assert (found.encoder.name, found.encoder.config) == (name, model.encoder.config)
    assert found.labelspace == model.labelspace
    assert found.labelspace.index("sofa") == 1
    assert (found.seed, found.temperature, found.provenance) == (
        model.seed,
        model.temperature,
        model.provenance,
    )
    assert not found.encoder.training
    for key, tensor in model.encoder.state_dict().items():
        assert torch.equal(found.encoder.state_dict()[key], tensor)
        assert found.encoder.state_dict()[key].dtype == tensor.dtype
    assert found.to_bytes() == data == make(name).to_bytes()


def test_a_loaded_model_can_be_trained_on() -> None:
    encoder = Model.from_bytes(make().to_bytes()).encoder
    assert all(p.requires_grad and p.device.type == "cpu" for p in encoder.parameters())


def test_numpy_opens_the_file() -> None:
    with np.load(io.BytesIO(make().to_bytes()), allow_pickle=False) as archive:
        assert archive["embed.weight"].shape == (32, 192)


def test_the_hash_is_of_what_decides_an_answer_and_of_nothing_else() -> None:
    model, other = make(), make()
    other.seed, other.provenance = 8, {}
    other.labelspace = Labelspace("another name", LABELSPACE.classes)
    assert other.hash == model.hash
    other.labelspace = Labelspace("office", ("couch", "chair", "plant"))
    assert other.hash != model.hash
    assert make(self_loops=False).hash != model.hash
    warmer = make()
    warmer.temperature = 0.5
    assert warmer.hash != model.hash, "the temperature decides probabilities"
    weights = make()
    with torch.no_grad():
        next(weights.encoder.parameters())[0, 0] += 1e-6
    assert weights.hash != model.hash
    statistics = make()
    statistics.encoder.get_buffer("layers.0.norm.running_mean")[0] = 0.5
    assert statistics.hash != model.hash


def test_a_labelspace_of_another_size_and_a_bad_temperature_are_refused() -> None:
    with pytest.raises(ModelError, match=r"expected a labelspace of 3 classes \(got 2\)"):
        Model(make().encoder, Labelspace("x", ("a", "b")))
    for temperature in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ModelError, match="positive temperature"):
            Model(make().encoder, LABELSPACE, temperature=temperature)


def test_provenance_must_be_plain_json() -> None:
    for value in (object(), float("nan")):
        model = make()
        model.provenance = {"x": value}
        with pytest.raises(ModelError, match="expected a header that is plain JSON"):
            model.to_bytes()


def test_files_are_written_whole_and_loaded(tmp_path: Path) -> None:
    path = tmp_path / "office.model"
    path.write_bytes(b"an earlier one")
    make().save(path)
    assert Model.load(path).hash == make().hash
    assert os.listdir(tmp_path) == ["office.model"]  # noqa: PTH208  nothing temporary is left


def test_a_failed_write_leaves_the_earlier_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "office.model"
    path.write_bytes(b"an earlier one")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ModelError, match="No space left on device"):
        make().save(path)
    assert path.read_bytes() == b"an earlier one"
    assert len(list(tmp_path.iterdir())) == 1


def test_paths_that_lead_nowhere_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"expected a model file .*No such file"):
        Model.load(tmp_path / "absent.model")
    with pytest.raises(ModelError, match=r"expected a model file .*directory"):
        Model.load(tmp_path)
    with pytest.raises(ModelError, match=r"expected a path to write the model to .*No such file"):
        make().save(tmp_path / "absent" / "x.model")
    (tmp_path / "bad.model").write_bytes(b"{}")
    with pytest.raises(ModelError, match=r"bad\.model: expected a semloc model"):
        Model.load(tmp_path / "bad.model")


# hostile and damaged files


def test_what_is_no_model_is_refused() -> None:
    for data in (b"", b"PK", b"hello" * 100, pickle.dumps({"weights": 1})):
        refused(data, "expected a semloc model")
    buffer = io.BytesIO()
    torch.save(make().encoder.state_dict(), buffer)
    refused(buffer.getvalue(), "expected a semloc model")
    buffer = io.BytesIO()
    np.savez(buffer, weights=np.zeros(3))
    refused(buffer.getvalue(), "archive without header.json")


def test_a_file_cut_off_anywhere_is_refused() -> None:
    data = make().to_bytes()
    for cut in (10, len(data) // 2, len(data) - 30, len(data) - 1):
        refused(data[:cut], "truncated or damaged")


def test_a_flipped_bit_never_gives_another_model() -> None:
    data, expected = make("tfidf").to_bytes(), make("tfidf").to_bytes()
    rng = np.random.default_rng(0)
    for position in rng.integers(len(data), size=400):
        damaged = bytearray(data)
        damaged[position] ^= 1 << int(rng.integers(8))
        try:
            found = Model.from_bytes(bytes(damaged))
        except ModelError:
            continue
        assert found.to_bytes() == expected  # a bit of the archive that means nothing (a date, a permission)


class Trap:
    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return os.system, ("touch trapped",)


def test_a_pickle_inside_is_refused_unopened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    hostile = npy(np.array([Trap()], dtype=object), allow_pickle=True)
    refused(with_tensor("embed.weight", hostile), "expected tensor 'embed.weight' of shape .* and type float32")
    refused(with_tensor("embed.weight", pickle.dumps(Trap())), "expected tensor 'embed.weight' as .npy")
    refused(rewritten(lambda members: members.__setitem__("x.pkl", pickle.dumps(Trap()))), "expected only tensors")
    assert list(tmp_path.iterdir()) == []


def test_a_later_version_says_so() -> None:
    refused(with_header(version=2), r"expected a model of version 1 or earlier \(got 2\)")
    refused(with_header(version=2, labelspace=None), "of version 1 or earlier")  # whatever else has changed


def test_a_changed_header_or_weight_does_not_match_the_hash() -> None:
    refused(with_tensor("embed.bias", npy(np.ones(32, np.float32))), "expected content of hash")
    header = json.loads(dict_of(make().to_bytes())["header.json"])
    empty = header["labelspace"] | {"ids": {}, "mobility": {}, "synonyms": {}}
    refused(
        with_header(labelspace=empty | {"classes": ["a", "b", "c"]}),
        "expected content of hash",
    )
    refused(with_header(config=header["config"] | {"self_loops": False}), "expected content of hash")


def dict_of(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_tensors_missing_or_too_many_are_named() -> None:
    def without(members: dict[str, bytes]) -> None:
        del members["gat.attention.npy"]

    refused(rewritten(without), r"expected tensor 'gat.attention' \(got a model without it\)")
    refused(with_tensor("stranger", npy(np.zeros(2, np.float32))), r"expected \d+ tensors \(got also stranger\)")


@pytest.mark.parametrize(
    ("array", "match"),
    [
        (np.zeros((3, 3), np.float32), "of shape"),
        (np.zeros(32, np.float64), "type float32"),
        (np.full(32, np.nan, np.float32), "finite numbers"),
        (np.full(32, np.inf, np.float32), "finite numbers"),
    ],
    ids=["shape", "type", "nan", "infinity"],
)
def test_tensors_of_another_kind_are_refused(array: np.ndarray, match: str) -> None:
    refused(with_tensor("embed.bias", npy(array)), match)


def test_tensor_bytes_must_be_as_many_as_declared() -> None:
    content = npy(np.zeros(32, np.float32))
    refused(with_tensor("embed.bias", content[:-4]), r"expected 128 bytes .* \(got 124\)")
    refused(with_tensor("embed.bias", content + b"more"), r"expected 128 bytes .* \(got 132\)")


def test_a_negative_variance_is_refused() -> None:
    name = "layers.0.norm.running_var"
    refused(with_tensor(name, npy(np.full(64, -1.0, np.float32))), "variances of at least 0")


def test_sizes_are_checked_before_anything_is_unpacked() -> None:
    refused(make().to_bytes(), "expected a model of at most 1000 bytes", max_bytes=1000)
    bomb = rewritten(lambda members: members.__setitem__("bomb.npy", bytes(50_000_000)), zipfile.ZIP_DEFLATED)
    assert len(bomb) < 400_000
    refused(bomb, "expected stored members")


def test_a_header_that_claims_a_huge_encoder_sets_no_memory_aside() -> None:
    header = json.loads(dict_of(make().to_bytes())["header.json"])
    empty = header["labelspace"] | {"ids": {}, "mobility": {}, "synonyms": {}}
    refused(with_header(config=header["config"] | {"hidden": 10**12}), "expected a model to build")
    classes = [f"c{i}" for i in range(100_000)]
    config = header["config"] | {"hidden": 1024}
    refused(with_header(config=config, labelspace=empty | {"classes": classes}), "of shape")


@pytest.mark.parametrize(
    "fields",
    [
        {"encoder": "os.system"},
        {"encoder": "paper\nsecond line"},
        {"encoder": "unheard_of"},
        {"config": {"layers": 2, "surprise\nline": 1}},
        {"hash": "0" * 64},
        {"hash": "x"},
        {"seed": "7"},
        {"temperature": -1.0},
        {"labelspace": {"name": "x"}},
        {"format": "another"},
    ],
    ids=str,
)
def test_a_nonsense_header_is_one_line(fields: dict[str, Any]) -> None:
    refused(with_header(**fields), "expected")


def test_a_header_nested_past_all_reason_is_one_line() -> None:
    deep = b"[" * 100_000 + b"]" * 100_000
    text = dict_of(make().to_bytes())["header.json"].replace(b'"epochs":3', b'"epochs":' + deep)
    refused(rewritten(lambda members: members.__setitem__("header.json", text)), "expected the header")
