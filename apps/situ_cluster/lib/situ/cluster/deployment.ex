defmodule Situ.Cluster.Deployment do
  @moduledoc false
  # Holds the arguments of `Situ.Cluster.deploy/2`, parsed once and sent to every node. They must therefore be plain
  # data.
  alias Situ.{Error, Options, Pipeline}

  @location {:or, [:atom, :string, {:tuple, [{:in, [:near]}, :string]}]}

  @place_schema [
    on: [
      type: {:or, [@location, {:list, @location}]},
      doc:
        "A node, a label (string), `{:near, device}` (the node with the device, then the nodes with the shortest" <>
          " round trip to it), or a list in order of preference. Default: the least busy node."
    ],
    only: [type: :boolean, default: false, doc: "Never run on any node that `on:` does not name."],
    deterministic: [
      type: :boolean,
      default: false,
      doc:
        "The same inputs always produce the same outputs (see *When a node is lost* in `Situ.Cluster`)."
    ]
  ]

  @schema [
    name: [type: :string, doc: "The deployment's name. Default: the end of the module's name."],
    opts: [type: :keyword, default: [], doc: "Options of the pipeline's `build/2`."],
    place: [
      type: :list,
      default: [],
      doc:
        "`{\"Path\", rules}` for a component or composite and everything below it; `{:rest, rules}` for all others."
    ],
    checkpoint: [
      type: :pos_integer,
      default: 1_000_000_000,
      doc:
        "Time between checkpoints of a part, ns. A part that is not deterministic publishes its outputs with them."
    ],
    lease: [
      type: :pos_integer,
      default: 1_000_000_000,
      doc: "Time without a sign of life after which another node takes over a part, ns."
    ],
    retain: [
      type: {:or, [:pos_integer, {:in, [:all]}]},
      default: :all,
      doc:
        "How much of each stream the log keeps, ns of originating time. A part that resumes after a longer time" <>
          " fails (`:log_trimmed`), because messages are missing. A part that records in segments, or has" <>
          " components which cannot be carried over, restarts from the first message and therefore needs `:all`."
    ],
    balance: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "How often to check whether a part should move to a less busy node, ns (`balance/1`)."
    ],
    publish: [
      type: {:list, :string},
      default: [],
      doc: "Streams that the log keeps even if no other part reads them (see `read/2`)."
    ],
    direct: [
      type: {:list, :string},
      default: [],
      doc:
        "Streams between parts that bypass the log. They have back-pressure and lose nothing while all nodes are" <>
          " running; messages in flight are lost when a node is lost. A stream also bypasses the log if all of its" <>
          " readers use a lossy policy, unless it is in `publish:`."
    ],
    pipeline: [
      type: :keyword,
      default: [],
      doc: "Settings of the parts' pipelines (`Situ.Pipeline`): `replay:` and so on."
    ]
  ]

  @enforce_keys [:name, :module, :opts, :rules, :checkpoint, :lease] ++
                  [:retain, :balance, :publish, :direct, :pipeline]
  # `Situ.Cluster.Deployments` sets `run` when it stores the deployment in the log.
  defstruct [:run | @enforce_keys]

  @type rule :: %{
          on: [node() | String.t() | {:near, String.t()}],
          only: boolean(),
          deterministic: boolean()
        }
  @type t :: %__MODULE__{
          run: String.t() | nil,
          name: String.t(),
          module: module(),
          opts: keyword(),
          rules: [{String.t() | :rest, rule()}],
          checkpoint: pos_integer(),
          lease: pos_integer(),
          retain: pos_integer() | :all,
          balance: pos_integer() | nil,
          publish: [String.t()],
          direct: [String.t()],
          pipeline: keyword()
        }

  @doc false
  def schema, do: @schema
  @doc false
  def place_schema, do: @place_schema

  @spec new(module(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(module, opts) when is_atom(module) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         :ok <- check_pipeline(module),
         {:ok, build_opts} <- Pipeline.validate_options(module, opts[:opts]),
         :ok <- check_name(opts[:name]),
         {:ok, rules} <- parse_rules(opts[:place], []) do
      {:ok,
       %__MODULE__{
         name: opts[:name] || module |> Module.split() |> List.last(),
         module: module,
         opts: build_opts,
         rules: rules,
         checkpoint: opts[:checkpoint],
         lease: opts[:lease],
         retain: opts[:retain],
         balance: opts[:balance],
         publish: opts[:publish],
         direct: opts[:direct],
         pipeline: opts[:pipeline]
       }}
    end
  end

  defp check_pipeline(module) do
    if Code.ensure_loaded?(module) and function_exported?(module, :build, 2),
      do: :ok,
      else:
        {:error,
         Error.new(:not_a_pipeline, "#{inspect(module)} is not a pipeline",
           why:
             "every node builds the pipeline itself, so it must be a module and not a function",
           fix: "add `use Situ.Pipeline` to it, and make it available on every node"
         )}
  end

  # The subjects of the log begin with the name and a dot.
  defp check_name(name) do
    if is_binary(name) and (name == "" or String.contains?(name, ".")),
      do:
        {:error,
         Error.new(
           :bad_option,
           "invalid deployment name #{inspect(name)}: it is empty or contains a dot",
           why:
             "in the log, a dot separates the name of the deployment from the names of its streams",
           fix: "use a name without dots, for example with - or _ instead"
         )},
      else: :ok
  end

  defp parse_rules([], rules), do: {:ok, Enum.reverse(rules)}

  defp parse_rules([{path, rule} | rest], rules) when is_binary(path) or path == :rest do
    with {:ok, rule} <- Options.validate(rule, @place_schema) do
      rule = %{
        on: List.wrap(rule[:on]),
        only: rule[:only],
        deterministic: rule[:deterministic]
      }

      parse_rules(rest, [{path, rule} | rules])
    end
  end

  defp parse_rules([other | _], _rules) do
    {:error,
     Error.new(:bad_place, "invalid rule in place: #{inspect(other, limit: 5)}",
       fix: ~s(write {"Path", on: node} or {:rest, on: "label"})
     )}
  end
end
