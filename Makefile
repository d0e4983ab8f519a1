# Everything a person or CI runs. `make demo` and `make test` need nothing but Rust, a C++ compiler and Python with pip.
.PHONY: demo build test fmt lint doc deny check

CARGO ?= cargo
DEMO_DIR ?= demo

# The main job, start to end, on an embedded database: a table at the end, a report in $(DEMO_DIR).
demo: .libtorch
	$(CARGO) build --release --bin gleaner-server --bin gleaner
	target/release/gleaner demo --server-bin target/release/gleaner-server --dir $(DEMO_DIR)

build: .libtorch
	$(CARGO) build --release --bin gleaner-server --bin gleaner

# Every test, from a bare clone.
test: .libtorch
	$(CARGO) test --workspace --locked

fmt:
	$(CARGO) fmt --all -- --check

lint: .libtorch
	$(CARGO) clippy --workspace --all-targets --locked -- -D warnings

doc: .libtorch
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --workspace --no-deps --locked

# Licences, advisories, sources: where cargo-deny is installed and its advisory database can be had.
deny:
	@if command -v cargo-deny >/dev/null; then $(CARGO) deny check; else echo "cargo-deny is not installed: skipped"; fi

# What CI runs.
check: fmt lint test doc deny

.libtorch:
	scripts/libtorch.sh
