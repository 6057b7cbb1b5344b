defmodule Situ.Experiment do
  @moduledoc """
  Runs a pipeline with many parameters over the sessions of a dataset, and compares its results with the truth.

      defmodule Tune do
        use Situ.Experiment
        alias Situ.Annotation.Segmenting

        @impl true
        def parameters, do: [threshold: [0.3, 0.5, 0.7], hold: {:time_ns, [0, Situ.Time.ms(200)]}]

        @impl true
        def build(_p, session, parameters) do
          speaking =
            session
            |> Situ.Experiment.stream("Level")
            |> Situ.map(&(&1 > parameters.threshold))

          %{"Speaking" => Segmenting.from_booleans(speaking, track: "P1")}
        end

        @impl true
        def metrics, do: [speaking: Situ.Metric.intervals(truth: "Speaking.Truth")]
      end

  `situ experiment run tune.exs study.json` runs every combination of parameters over every session, as a replay as fast
  as possible, and `situ experiment show study.json` prints the table. The guide `docs/guides/experiments.md` shows a
  complete experiment.

  Each result belongs to one session and one set of parameters. It is written before the next one begins, so a run that
  was killed continues where it was. A result is computed again only if its code, its parameters or its recordings have
  changed: see `cached/3` for parts that many sets share.

  ## Results

  The folder `FILE.experiments/NAME` next to the dataset file contains:

  | file | contents |
  |---|---|
  | `results.jsonl` | one line of JSON for each finished session and set: parameters, measurements, time, error |
  | `runs/RUN.json` | a run: its sets and sessions, and everything that it depended on (commit, versions, machine, hashes) |
  | `outputs/` | the streams that `build/3` returned, a recording for each result |
  | `stages/` | the streams of `cached/3` |
  | `differences/` | recordings of where two sets differ in a session, which the studio and `check` write |
  | `comments.json`, `baseline.json` | what people wrote about the sets, and the set that others are compared with |

  The next run computes everything again if the folder was deleted, except for comments and the baseline.
  """
  # See docs/adr/0171-experiments-are-modules-with-four-callbacks.md.
  alias Situ.Experiment.{Input, StageCache}

  @typedoc "The session that `build/3` reads: see `stream/3`, `has_stream?/2`, `metadata/1` and `cached/3`."
  @type session :: Input.t()
  @type streams :: %{String.t() => Situ.Stream.t()} | [{String.t() | atom(), Situ.Stream.t()}]

  @doc "Returns the sessions to run. Default: all."
  @callback sessions(Situ.Dataset.t()) :: [Situ.Dataset.Session.t()]

  @doc """
  Returns the values of each parameter: a list, or `{:time_ns, list}` for durations in nanoseconds.
  """
  @callback parameters() :: [{atom(), [term()] | {:time_ns, [Situ.Time.duration()]}}]

  @doc """
  Builds the pipeline for one session and one set of parameters, a map. Returns the streams to record, by name.
  """
  @callback build(Situ.Pipeline.t(), session(), parameters :: map()) :: streams()

  @doc "Returns the metrics by name: `Situ.Metric`, or functions. The first one is the one to improve."
  @callback metrics() :: [{atom(), Situ.Metric.t() | (Situ.Metric.measured() -> term())}]

  @doc "Returns the settings: `speed:` of the replay, `:max` (default) or a number such as `1.0` for real time."
  @callback settings() :: [speed: :max | number()]

  @doc false
  defmacro __using__(_opts) do
    quote do
      @behaviour Situ.Experiment
      @impl true
      def sessions(dataset), do: dataset.sessions
      @impl true
      def settings, do: []
      defoverridable sessions: 1, settings: 0
    end
  end

  @doc """
  Returns a stream of the session, as `Situ.Dataset.Importer.stream/3` does.
  """
  @spec stream(session(), String.t(), keyword()) :: Situ.Stream.t()
  def stream(%Input{} = session, name, opts \\ []),
    do: Input.open_stream(session, name, opts)

  @doc "Returns whether a name refers to exactly one stream of the session."
  @spec has_stream?(session(), String.t()) :: boolean()
  def has_stream?(%Input{} = session, name), do: Input.has_stream?(session, name)

  @doc "Returns the metadata of the session, a JSON object."
  @spec metadata(session()) :: map()
  def metadata(%Input{session: session}), do: session.metadata

  @doc """
  Returns the streams of a stage that is computed once for each session and then read from disk.

      def build(_p, session, parameters) do
        %{mouths: mouths, voice: voice} = Situ.Experiment.cached(session, :perceive, model: parameters.model)
        %{"Speaking" => Situ.Infer.who_speaks(mouths, voice, window: parameters.window)}
      end

      def perceive(session, options), do: %{mouths: ..., voice: ...}

  `stage` is a function of the experiment, or `{module, function}`. It receives the session and the options as a map,
  and returns a map of streams with atoms as keys. It is computed again if its options, its code or the session's
  recordings have changed, so give it only the parameters that it uses. Its code consists of the function, the functions
  of the same module that it calls, and all modules that these refer to.
  """
  @spec cached(session(), atom() | {module(), atom()}, keyword()) :: %{atom() => Situ.Stream.t()}
  def cached(%Input{} = session, stage, options \\ []),
    do: StageCache.open_streams(session, stage, options)
end
