"""Reads a data set: sample by sample, or as batches of torch tensors."""

from torch.utils.data import DataLoader

from simulator.dataset import open_dataset

dataset = open_dataset("out/flying_things_64", "train")
sample = dataset[0]
print(sample.measurement.shape, sample.rgb.shape, sample.depth_m.shape)

batch = next(iter(DataLoader(dataset, batch_size=2)))
print({name: tuple(value.shape) for name, value in batch.items() if hasattr(value, "shape")})
