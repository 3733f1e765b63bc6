import pytest
import torch

from semloc_core.encoding.encoder import ENCODERS, build_encoder
from semloc_core.errors import ConfigError


@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_every_encoder_is_built_from_its_defaults_from_plain_values_and_from_a_struct(name: str) -> None:
    encoder = build_encoder(name, None, 5)
    assert encoder.name == name
    assert build_encoder(name, encoder.config, 5).config == encoder.config
    assert build_encoder(name, {}, 5).config == encoder.config
    assert encoder.trainable == (name in ("paper", "geodesic_attention"))
    assert encoder.extraction.radius_m > 0
    assert encoder.extraction.visibility_m == (4.0 if name in ("paper", "bag_of_words", "tfidf") else 0.0)


def test_names_are_the_agreed_ones() -> None:
    assert set(ENCODERS) == {"paper", "geodesic_attention", "rings", "bag_of_words", "tfidf", "histogram"}


def test_an_unknown_name_lists_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"expected an encoder among paper, .* \(got 'papers'\)"):
        build_encoder("papers", None, 5)


def test_a_labelspace_without_classes_is_refused() -> None:
    with pytest.raises(ConfigError, match="expected at least one class"):
        build_encoder("rings", None, 0)


def test_the_generator_decides_the_initial_weights() -> None:
    def weights(seed: int) -> torch.Tensor:
        encoder = build_encoder("paper", {"layers": 1}, 5, torch.Generator().manual_seed(seed))
        return torch.cat([p.detach().flatten() for p in encoder.parameters()])

    assert torch.equal(weights(1), weights(1))
    assert not torch.equal(weights(1), weights(2))
