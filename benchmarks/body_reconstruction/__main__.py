"""Bodies found again in pictures of themselves, most of each hidden by clothes (S7.12).

    python -m benchmarks.body_reconstruction --out OUT [--cases clean noisy ...] [--bodies 4]
                                             [--views 20] [--size 512] [--iterations 100]

Random bodies of the embedded model in loose clothes are seen by MagicMan's ring. Every body leaves
a row in OUT/rows and a picture, so an interrupted run goes on where it stopped; table.txt and
results.json hold all rows. Of bodies with an estimate,
the stages of landmarks are compared with Adam.
"""

import argparse
import json
from pathlib import Path

import jax

from benchmarks.body_reconstruction.table import HEAD, line, write_table


def main() -> None:
    """Run the benchmark."""
    from benchmarks.body_reconstruction.attempt import CASES, attempt
    from benchmarks.body_reconstruction.landmark_methods import compare
    from benchmarks.body_reconstruction.scene import wrong_estimate
    from dress_jax.application.reconstruct_body import comparison
    from dress_jax.io.bodies import load_default_body
    from dress_jax.io.figures import write_comparison
    from dress_jax.reconstruction import body_in_world

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", nargs="+", choices=tuple(CASES), default=tuple(CASES))
    parser.add_argument("--bodies", type=int, default=4)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--iterations", type=int, default=100)
    options = parser.parse_args()
    (options.out / "rows").mkdir(parents=True, exist_ok=True)
    model, rows, text = load_default_body(), [], ""
    print(HEAD, flush=True)
    for name in options.cases:
        for seed in range(options.bodies):
            path = options.out / "rows" / f"{name}-{seed}.json"
            if not path.is_file():
                row, scene, found = attempt(
                    model,
                    CASES[name],
                    seed,
                    views=options.views,
                    size=options.size,
                    iterations=options.iterations,
                )
                if CASES[name].estimate:
                    start = wrong_estimate(model, scene.truth, seed)
                    row["methods"] = compare(model, scene.views, start)
                pictures, columns = comparison(
                    scene.views,
                    body_in_world(model, found.parameters).vertices,
                    model.faces,
                    truth=body_in_world(model, scene.truth).vertices,
                )
                write_comparison(options.out / f"{name}-{seed}.png", pictures, columns)
                path.write_text(json.dumps(row, indent=1))
            rows.append(json.loads(path.read_text()))
            print(line(rows[-1]), flush=True)
            text = write_table(rows, options.out)
    print(text)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
