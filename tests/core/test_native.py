import numba

from dress_jax.core.native import compiled


def test_compilation_without_a_cache_folder(monkeypatch):
    plain = numba.njit

    def refuses_to_cache(*args, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return plain(*args, **options)

    monkeypatch.setattr(numba, "njit", refuses_to_cache)
    assert compiled(lambda x: x + 1)(2) == 3
