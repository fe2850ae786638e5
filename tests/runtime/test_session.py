import numpy as np

from duospacenet.runtime.session import to_tensors


def test_tensors_share_the_memory_of_their_arrays():
    array = np.arange(6, dtype=np.float32)
    assert to_tensors(x=array)["x"].data_ptr() == array.ctypes.data
