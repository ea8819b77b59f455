# Short names for what is done often; `.ci/run` is what counts.

# Type-check everything.
check:
    cargo check --workspace --all-targets

# The fast tests.
test *args:
    cargo test {{ args }}

# Format and lint.
lint:
    cargo fmt --all
    cargo clippy --workspace --all-targets -- -D warnings

# One scenario by name.
scenario name:
    cargo run -- scenario run tests/scenarios/{{ name }}.toml

# Everything.
ci:
    .ci/run
