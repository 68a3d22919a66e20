"""What the training of controllers stands on."""

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("rsl_rl")

from fiatlux.train.settings import Settings
from fiatlux.train.walk import models
from fiatlux.train.worlds import Worlds


def test_reflected_observations_give_reflected_actions_and_equal_values():
    torch.manual_seed(0)
    worlds = Worlds(2, "cpu")
    actor, critic = models(worlds, Settings(hidden=(64, 32), critic=(64, 32)))
    for model, group in ((actor, "policy"), (critic, "critic")):
        network = model.mlp
        numbers = torch.randn(16, worlds.observation[group].shape[1])
        seen, mirrored = network(numbers), network(network.inputs(numbers))
        torch.testing.assert_close(network.outputs(seen), mirrored, atol=1e-5, rtol=0)
        assert (seen - mirrored).abs().max() > 1e-3 or group == "critic"
    worlds.env.close()


def test_pairs_of_units_need_even_layers():
    worlds = Worlds(1, "cpu")
    with pytest.raises(ValueError, match="even"):
        models(worlds, Settings(hidden=(63, 32)))
    worlds.env.close()
