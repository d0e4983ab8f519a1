"""The losses of pretraining: MTP and TR share one bidirectional pass, AA has a causal one."""

import torch
from torch import Tensor, nn

from batches import Batch
from model import Model, Shape, Size, Statistics, attention_mask


class Learner(nn.Module):
    """The model with its statistics, in the names of a checkpoint."""

    def __init__(self, shape: Shape, size: Size, window: int):
        super().__init__()
        self.model = Model(shape, size, window)
        self.statistics = Statistics(shape, size)

    def steps(self, batch: Batch) -> Tensor:
        """[N, 3, d]."""
        statistics, model = self.statistics, self.model
        images = [camera.input(x) for camera, x in zip(statistics.camera, batch.images)]
        o = model.image(images)
        m = model.token.proprioception(statistics.proprioception(batch.proprioception))
        a = model.token.action(statistics.action(batch.action))
        return torch.stack([o, m, a], 1)

    def targets(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """The target of each head, [W, L, ...]."""
        statistics = self.statistics
        small = [camera.small(x) for camera, x in zip(statistics.camera, batch.images)]
        parts = torch.cat(small, 1), statistics.proprioception(batch.proprioception), statistics.action(batch.action)
        return tuple(part[batch.index].unflatten(0, batch.valid.shape) for part in parts)

    def loss(self, batch: Batch, objectives: tuple[str, ...]) -> Tensor:
        model, steps, targets = self.model, self.steps(batch), self.targets(batch)
        total = torch.zeros(())
        if "mtp" in objectives or "tr" in objectives:
            tokens = model.token(steps, batch.index, batch.hidden)
            z = model.transformer(tokens, attention_mask(batch.valid, causal=False))
            heads = zip(("image", "proprioception", "action"), targets)
            errors = [squared_error(model.head[name](z[..., i, :]), y) for i, (name, y) in enumerate(heads)]
            errors = torch.stack(errors, -1)
            if "mtp" in objectives:
                total = total + sum_per_step(errors, batch.hidden, batch.valid)
            if "tr" in objectives:
                total = total + sum_per_step(errors, ~batch.hidden & batch.valid.unsqueeze(-1), batch.valid)
        if "aa" in objectives:
            tokens = model.token(steps, batch.index, None)
            z = model.transformer(tokens, attention_mask(batch.valid, causal=True))
            errors = squared_error(model.head["action"](z[..., 1, :]), targets[2])
            valid = batch.valid.float()
            total = total + (errors * valid).sum() / valid.sum().clamp_min(1)
        return total


def squared_error(prediction: Tensor, target: Tensor) -> Tensor:
    return (prediction - target).square().mean(-1)


def sum_per_step(errors: Tensor, counted: Tensor, valid: Tensor) -> Tensor:
    return (errors * counted.float()).sum() / valid.float().sum().clamp_min(1)
