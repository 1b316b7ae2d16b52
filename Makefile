# Everything a user or CI calls. Set-up happens once, in .venv, from requirements.lock.
CORES ?= 2
BIN := .venv/bin
READY := .venv/.ready
SMK := workflow/rules/*.smk Snakefile workflow/Snakefile examples/own-study/Snakefile
# Some containers turn bytecode off: every job would then compile its imports anew, half of its time.
unexport PYTHONDONTWRITEBYTECODE
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: report test test-slurm bench docs lint format lock audit clean

report: $(READY)  ## set up once, then run the pipeline on the built-in default
	@$(BIN)/python -m snakemake --cores $(CORES) || { \
		[ -z "$$(ls .snakemake/locks 2>/dev/null)" ] || \
		echo "a lock is there: if no other run is at work here, $(BIN)/python -m snakemake --unlock, then again" >&2; \
		exit 1; }
	@echo "report: $(CURDIR)/reports/index.html"

test: $(READY)  ## set up once, then run every test
	@scripts/setup browser
	@$(BIN)/python -m pytest --numprocesses $(CORES) --dist loadfile

test-slurm: $(READY)  ## the small run through a real Slurm on this machine (Debian, root)
	@scripts/setup slurm
	@$(BIN)/python -m pytest tests/slurm

bench: $(READY)  ## speed as ratios in one run; FILES=folder of .binary files, else built-in stand-ins
	@$(BIN)/python benchmarks/run.py $(if $(FILES),--files $(FILES))

docs: $(READY)  ## docs/ and the reference of the Python interface as a site, site/index.html
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "docs: $(CURDIR)/site/index.html"

lint: $(READY)
	@$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/snakefmt --check $(SMK)
	@$(BIN)/python -m snakemake --lint

format: $(READY)
	@$(BIN)/ruff check --fix-only . ; $(BIN)/ruff format . ; $(BIN)/snakefmt $(SMK)

lock:  ## make requirements.lock again from pyproject.toml (needs uv)
	uv pip compile --universal --python-version 3.11 --all-extras --generate-hashes --no-emit-index-url \
		--no-header --no-annotate pyproject.toml -o requirements.lock

audit: $(READY)  ## known vulnerabilities of the locked versions
	@$(BIN)/pip-audit --require-hashes --disable-pip -r requirements.lock

$(READY): requirements.lock pyproject.toml scripts/setup
	@scripts/setup venv && touch $@

clean:  ## remove results/ and what the last run made in reports/; what you have put there, data/ and .venv stay
	@[ ! -f results/reports.tsv ] || $(BIN)/python -c "from brdfatlas.pipeline.leftovers import record_reports_job as \
		record; record([], {}, 'results/reports.tsv', lambda line: None)" > /dev/null
	@rm -rf results .snakemake
	@mkdir -p reports
	@find reports -mindepth 1 -type d -empty -delete
	@find reports -type f ! -path reports/README.md | sed 's/$$/: kept, not as the last run made it/'
