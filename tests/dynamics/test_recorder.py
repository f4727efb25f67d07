"""The recorder keeps every frame to the last bit, in memory and on disk."""

import numpy as np
import pytest
from motion import DT, patch

from magphonon import DrivenVerlet
from magphonon.dynamics import Recorder


def test_recorder_keeps_what_was_there_in_memory_and_on_disk(tmp_path, monkeypatch):
    def record(particles=None):
        dyn = DrivenVerlet(patch(speed=0.05), DT, engine='compiled')
        seen = []
        dyn.attach(lambda: seen.append(dyn.displacements), 4)
        recorder = Recorder(dyn, particles, interval=4)
        dyn.run(40)
        return recorder, np.array(seen)

    recorder, seen = record()
    assert np.array_equal(recorder.displacements, seen)
    assert np.array_equal(recorder.times, DT * np.arange(0, 41, 4))
    monkeypatch.setattr('magphonon.dynamics.recorder.MEMORY', 100)
    spilled, _ = record([24, 3])
    assert isinstance(spilled.displacements, np.memmap)
    assert np.array_equal(spilled.displacements, seen[:, [24, 3]])
    spilled.motion.save(tmp_path / 'run.npz')
    with np.load(tmp_path / 'run.npz') as data:
        assert np.array_equal(data['displacements'], seen[:, [24, 3]])
        assert np.array_equal(data['particles'], [24, 3])
        assert np.array_equal(data['times'], recorder.times)
    dyn = DrivenVerlet(patch(), DT)
    assert Recorder(dyn).displacements.shape == (0, 49, 2)
    with pytest.raises(ValueError, match='indices from 0 to 48'):
        Recorder(dyn, [49])
    with pytest.raises(ValueError, match='interval must be a whole number'):
        Recorder(dyn, interval=0)
