"""What a scene that cannot be read says."""

import pytest

from magphonon.scenes.scene import read_scene


def refusal(file):
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the caller looks at the message
        read_scene(file)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert 'pydantic' not in message
    assert 'http' not in message
    return message.replace(f'{file}: ', '')  # before each fault
