defmodule Situ.Pipeline.Settings do
  @moduledoc false
  # The `pipeline:` options, parsed once.
  alias Situ.{Delivery, Error, Options, Pipeline}

  @schema [
    name: [
      type: {:or, [:string, :atom, {:tuple, [:atom, :any, :any]}, {:tuple, [:atom, :any]}]},
      doc:
        "The pipeline's name; by default the module's last name, or \"Pipeline\". " <>
          "An atom, `{:via, module, key}` or `{:global, key}` is also registered, and every function takes it as " <>
          "the pipeline. The key is then the label in lists, logs and metrics."
    ],
    replay: [
      type: :keyword,
      default: [],
      doc: "`interval: {from | :unbounded, to | :unbounded}` and `speed:` (a number, or `:max`)."
    ],
    clock: [
      type: :any,
      doc: "The `Situ.Clock` of the pipeline (in tests, `Situ.Clock.manual/1`)."
    ],
    default_policy: [
      type: {:struct, Situ.Delivery},
      doc: "The policy of connections without their own; default `Situ.Delivery.unlimited()`."
    ],
    diagnostics: [
      type: {:or, [:boolean, :keyword]},
      default: false,
      doc: "Adds the Diagnostics stream (`interval:` in ns between snapshots, default 100 ms)."
    ],
    resume: [
      type: :map,
      default: %{},
      doc:
        "A checkpoint of `checkpoint/3`; its components continue from there, all others start fresh."
    ],
    averaging: [
      type: :pos_integer,
      default: 1_000_000_000,
      doc: "The span of the windowed statistics in diagnostics, in ns."
    ],
    message_sizes: [
      type: :boolean,
      default: false,
      doc:
        "Measures the size of every message for diagnostics: cheap for binaries, expensive for large terms."
    ],
    max_restarts: [
      type: :non_neg_integer,
      default: 3,
      doc:
        "How often a component may restart within `max_seconds` (after its process died, or after an exception " <>
          "under `on_error: :restart`); one more restart is an error that ends the pipeline."
    ],
    max_seconds: [
      type: :pos_integer,
      default: 5,
      doc: "The span of time, in seconds, over which `max_restarts` counts."
    ],
    progress_every: [
      type: :pos_integer,
      default: 500,
      doc: "Milliseconds between calls of the `:progress` handlers."
    ],
    stop_timeout: [
      type: :pos_integer,
      default: 30_000,
      doc: "Milliseconds without progress after which a stop kills the stuck components."
    ]
  ]

  @doc false
  def schema, do: @schema

  defstruct [
    :name,
    :registered,
    :origin,
    :clock,
    :mode,
    :reply,
    default_policy: nil,
    resume: %{},
    interval: {:unbounded, :unbounded},
    speed: 1.0,
    diagnostics: false,
    averaging: 1_000_000_000,
    message_sizes: false,
    max_restarts: 3,
    max_seconds: 5,
    progress_every: 500,
    stop_timeout: 30_000
  ]

  @type t :: %__MODULE__{}

  @replay [
    interval: [type: {:tuple, [:any, :any]}, default: {:unbounded, :unbounded}],
    speed: [type: {:or, [{:range, 0.0001, 1_000_000}, {:in, [:max]}]}]
  ]

  @spec parse(keyword(), :run | :linked | :unlinked, Pipeline.spec() | nil) ::
          {:ok, t()} | {:error, Error.t()}
  def parse(opts, mode, spec) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         {:ok, replay} <- Options.validate(opts[:replay], @replay),
         :ok <- check_name(opts[:name]),
         :ok <- check_interval(replay[:interval]),
         :ok <- check_clock(opts[:clock]),
         :ok <- check_spec(spec) do
      {:ok,
       %__MODULE__{
         name: name_string(opts[:name]) || default_name(spec),
         registered: if(not is_binary(opts[:name]), do: opts[:name]),
         clock: opts[:clock],
         mode: mode,
         default_policy: opts[:default_policy] || Delivery.unlimited(),
         interval: replay[:interval],
         speed: replay[:speed] || default_speed(mode, opts[:clock]),
         resume: opts[:resume],
         diagnostics: opts[:diagnostics],
         averaging: opts[:averaging],
         message_sizes: opts[:message_sizes],
         max_restarts: opts[:max_restarts],
         max_seconds: opts[:max_seconds],
         progress_every: opts[:progress_every],
         stop_timeout: opts[:stop_timeout]
       }}
    end
  end

  defp name_string(nil), do: nil
  defp name_string(name) when is_binary(name), do: name
  defp name_string({:via, Registry, key}), do: name_string(elem(key, 1))
  defp name_string({:via, _module, key}), do: name_string(key)
  defp name_string({:global, key}), do: name_string(key)

  defp name_string(name) when is_atom(name),
    do: name |> Atom.to_string() |> String.replace_prefix("Elixir.", "")

  defp name_string(key), do: Kernel.inspect(key)

  defp check_name({:via, Registry, key}) when elem(key, 0) != nil and tuple_size(key) in 2..3,
    do: :ok

  defp check_name({:via, module, _key}) when is_atom(module) and module != Registry, do: :ok
  defp check_name({:global, _key}), do: :ok
  defp check_name(name) when not is_tuple(name), do: :ok

  defp check_name(name) do
    {:error,
     Error.new(:bad_option, "option :name cannot be #{Kernel.inspect(name)}",
       why:
         "a tuple must be {:via, Registry, {registry, key}}, {:via, module, key} or {:global, key}"
     )}
  end

  # An explicit clock implies that messages should wait for it.
  defp default_speed(:run, nil), do: :max
  defp default_speed(_mode, _clock), do: 1.0

  defp default_name(spec) when is_atom(spec) and spec != nil,
    do: spec |> Module.split() |> List.last()

  defp default_name(_spec), do: "Pipeline"

  defp check_interval({from, to}) do
    ok? =
      valid_bound?(from) and valid_bound?(to) and
        (from == :unbounded or to == :unbounded or from <= to)

    if ok?,
      do: :ok,
      else:
        {:error,
         Error.new(:bad_interval, "invalid replay interval: #{inspect({from, to})}",
           fix: "use {from, to}, each a time in ns or :unbounded, with from <= to"
         )}
  end

  defp valid_bound?(bound), do: bound == :unbounded or is_integer(bound)

  defp check_clock(nil), do: :ok
  defp check_clock(%Situ.Clock{}), do: :ok

  defp check_clock(other),
    do: {:error, Error.new(:bad_option, "clock: must be a Situ.Clock, got: #{inspect(other)}")}

  defp check_spec(nil), do: :ok
  defp check_spec(fun) when is_function(fun, 1), do: :ok

  defp check_spec(module) when is_atom(module) do
    if Code.ensure_loaded?(module) and function_exported?(module, :build, 2),
      do: :ok,
      else: {:error, not_a_pipeline(module)}
  end

  defp check_spec(other), do: {:error, not_a_pipeline(other)}

  defp not_a_pipeline(spec) do
    Error.new(:not_a_pipeline, "#{inspect(spec)} is not a pipeline",
      fix: "use a module that uses Situ.Pipeline, or a function of one argument"
    )
  end
end
