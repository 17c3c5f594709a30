"""dress_jax beside what else can be installed today, on the same scenes; see docs/benchmarks.md."""
