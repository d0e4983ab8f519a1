//! The `gleaner-server` binary: parse, start logging, run, exit code. Must not depend on the inside of modules.

use std::{
    io::{Stdout, Write as _, stdout},
    process::ExitCode,
    time::Duration,
};

use clap::Parser as _;
use gleaner_recording::printable::{self, Escape, EscapingWriter};
use gleaner_server::{
    Listeners,
    config::{AuditConfig, Cli, Command, MaintenanceCommand, PlanConfig, ServeConfig, TlsConfig, TokenConfig},
    data_folder,
    error::{Error, Result},
    file_limit,
    lock::DataLock,
    program, shutdown,
    telemetry::{self, Traces},
};
use tokio::runtime::Runtime;

/// Exit code for arguments that cannot be parsed, the same as the parser's.
const ARGUMENTS: u8 = 2;
/// Exit code for a wrong configuration, as in sysexits.
const USAGE: u8 = 64;
/// Time for the server to end, in addition to its drain.
const ENDING: Duration = Duration::from_secs(10);
/// Time for work on other threads after the server has ended.
const LEFT_OVER: Duration = Duration::from_secs(1);

#[expect(clippy::print_stderr, reason = "logging may not be set up when these are reported")]
fn main() -> ExitCode {
    data_folder::access::keep_private();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(problem) if problem.use_stderr() => {
            // The parser's message quotes the arguments.
            eprint!("{}", Escape::Lines.apply(&problem.render().to_string()));
            return ExitCode::from(ARGUMENTS);
        }
        // `--help` or `--version`.
        Err(error) => error.exit(),
    };
    let stage = match cli.arm_fail_point().and_then(|()| Stage::set(&cli)) {
        Ok(stage) => stage,
        Err(problem) => {
            eprintln!("gleaner-server: {}", printable::field(&problem));
            return ExitCode::from(USAGE);
        }
    };
    let result = match cli.command {
        Command::Serve(config) => match config.validate() {
            Ok(()) => stage.serve(*config),
            Err(problem) => {
                eprintln!("gleaner-server: {}", printable::field(&problem));
                return ExitCode::from(USAGE);
            }
        },
        Command::Keep(command) => match keep(command) {
            Ok(true) => Ok(()),
            // The problems were printed already.
            Ok(false) => return ExitCode::FAILURE,
            Err(error) => Err(error),
        },
        Command::Token(config) => token(config),
        Command::Tls(config) => tls(&config),
        Command::Audit(config) => audit(config),
        Command::Plan(config) => plan(&config),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!(%error, "stopped");
            ExitCode::FAILURE
        }
    }
}

#[tokio::main(flavor = "current_thread")]
async fn keep(command: MaintenanceCommand) -> Result<bool> {
    ignore_file_limit_signal();
    let escape = match &command {
        MaintenanceCommand::Check(config) if config.json => Escape::Json,
        MaintenanceCommand::Check(_) | MaintenanceCommand::Backup(_) => Escape::Lines,
        MaintenanceCommand::Restore(_) | MaintenanceCommand::Rebuild(_) | MaintenanceCommand::Migrate(_) => {
            Escape::Lines
        }
    };
    gleaner_server::maintenance::run(&command, &mut output(escape)).await
}

#[tokio::main(flavor = "current_thread")]
async fn token(config: TokenConfig) -> Result<()> {
    ignore_file_limit_signal();
    gleaner_server::access::command::token(config, &mut output(Escape::Lines)).await
}

#[tokio::main(flavor = "current_thread")]
async fn audit(config: AuditConfig) -> Result<()> {
    ignore_file_limit_signal();
    gleaner_server::access::command::audit(config, &mut output(Escape::Lines)).await
}

fn tls(config: &TlsConfig) -> Result<()> {
    gleaner_server::access::tls::command::run(config, &mut output(Escape::Lines))
}

fn plan(config: &PlanConfig) -> Result<()> {
    let escape = if config.json { Escape::Json } else { Escape::Lines };
    writeln!(output(escape), "{}", config.report()).map_err(|error| Error::internal("writing the plan", error))
}

/// The output of commands, escaped because it has names from recordings and callers.
fn output(escape: Escape) -> EscapingWriter<Stdout> {
    EscapingWriter::new(stdout(), escape)
}

fn ignore_file_limit_signal() {
    if let Err(error) = file_limit::survive_limit() {
        tracing::warn!(%error, "a write beyond the file size limit would end the process");
    }
}

/// The parts that must exist before the first log line.
struct Stage {
    /// The runtime of the server, which also sends the traces. Other commands have their own.
    runtime: Option<Runtime>,
    traces: Traces,
}

impl Stage {
    fn set(cli: &Cli) -> std::result::Result<Self, String> {
        let serving = match &cli.command {
            Command::Serve(config) => Some(config),
            Command::Keep(_) | Command::Token(_) | Command::Tls(_) | Command::Audit(_) | Command::Plan(_) => None,
        };
        let runtime = serving
            .map(|config| threads(config))
            .transpose()
            .map_err(|error| format!("cannot start the threads of the runtime: {error}"))?;
        let _entered = runtime.as_ref().map(Runtime::enter);
        let otlp_endpoint = serving.and_then(|config| config.telemetry.otlp_endpoint.as_deref());
        let traces = telemetry::start(&cli.log, otlp_endpoint)?;
        Ok(Self { runtime, traces })
    }

    fn serve(self, config: ServeConfig) -> Result<()> {
        let Some(runtime) = self.runtime else { return Ok(()) };
        let served = runtime.block_on(serve(config));
        self.traces.finish();
        runtime.shutdown_timeout(LEFT_OVER);
        served
    }
}

/// The runtime of the server.
fn threads(config: &ServeConfig) -> std::io::Result<Runtime> {
    tokio::runtime::Builder::new_multi_thread().worker_threads(config.policies.io_threads()).enable_all().build()
}

#[expect(clippy::print_stdout, reason = "scripts that start a server on port 0 read this line")]
async fn serve(config: ServeConfig) -> Result<()> {
    if let Err(error) = shutdown::ignore_hangups() {
        tracing::warn!(%error, "SIGHUP would end the server");
    }
    ignore_file_limit_signal();
    // Before the first printed line: its reader may stop the server at once, and must not wait for one that cannot
    // serve.
    let stop_requested = shutdown::requested().map_err(|error| Error::internal("listening to signals", error))?;
    program::all_installed()?;
    let lock = match config.standby && config.data_dir.is_dir() {
        true => DataLock::take_if_free(&config.data_dir)?,
        false => Some(DataLock::take(&config.data_dir)?),
    };
    let listeners = Listeners::bind(&config).await?;
    if let Some(pages) = listeners.pages_url()? {
        println!("pages on {pages}");
    }
    if let Some(openpi) = listeners.openpi_url()? {
        println!("clients of openpi on {openpi}");
    }
    println!("listening on {}", listeners.url()?);
    let limit = Duration::from_secs(config.drain_seconds) + ENDING;
    gleaner_server::run(config, lock, listeners, async move {
        stop_requested.await;
        if let Err(error) = shutdown::must_end_within(limit) {
            tracing::error!(%error, "the time limit of the shutdown cannot be set");
        }
    })
    .await
}
