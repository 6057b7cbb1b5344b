defmodule Situ.Cluster.Deployment do
  @moduledoc false
  # The arguments of `Situ.Cluster.deploy/2`, parsed once and sent to every node, so plain data only.
  alias Situ.{Error, Options}

  @where {:or, [:atom, :string, {:tuple, [{:in, [:near]}, :string]}]}

  @place [
    on: [
      type: {:or, [@where, {:list, @where}]},
      doc:
        "A node, a label (text), `{:near, device}` (the node that has it, then those with the shortest way to" <>
          " it), or several in order of preference; without it the least busy node."
    ],
    only: [type: :boolean, default: false, doc: "Nowhere else, even when those are lost."],
    deterministic: [
      type: :boolean,
      default: false,
      doc: "The same inputs give the same outputs, always: see above."
    ]
  ]

  @schema [
    name: [type: :string, doc: "The deployment's name; by default the module's last name."],
    opts: [type: :keyword, default: [], doc: "Options of the pipeline's `build/2`."],
    place: [
      type: :list,
      default: [],
      doc:
        "`{\"Path\", rules}` for a component or composite and all below it; `{:rest, rules}` for all else."
    ],
    checkpoint: [
      type: :pos_integer,
      default: 1_000_000_000,
      doc:
        "Ns between checkpoints of a part; outputs of a part that is not deterministic go out with them."
    ],
    lease: [
      type: :pos_integer,
      default: 1_000_000_000,
      doc: "Ns without a sign of life after which another node takes a part over."
    ],
    retain: [
      type: {:or, [:pos_integer, {:in, [:all]}]},
      default: :all,
      doc:
        "How much of each stream the log keeps, ns of originating time. A part that comes back after longer than" <>
          " that fails (`:log_trimmed`): it cannot know what it has missed. A part that records, or whose components" <>
          " cannot be carried over, begins with the first message: such a part needs `:all`."
    ],
    balance: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Ns between looks at whether a part should move to a less busy node (`balance/1`)."
    ],
    publish: [
      type: {:list, :string},
      default: [],
      doc: "Streams kept in the log although no other part reads them (see `read/2`)."
    ],
    direct: [
      type: {:list, :string},
      default: [],
      doc:
        "Streams that cross from part to part and bypass the log: with back-pressure and without loss while all" <>
          " nodes are well; what is under way when one is lost is lost. Streams that all their readers take by a" <>
          " lossy policy are such, unless they are in `publish:`."
    ],
    pipeline: [
      type: :keyword,
      default: [],
      doc: "Settings of the parts' pipelines (`Situ.Pipeline`): `replay:` and so on."
    ]
  ]

  @enforce_keys [:name, :module, :opts, :rules, :checkpoint, :lease] ++
                  [:retain, :balance, :publish, :direct, :pipeline]
  # `Situ.Cluster.Deployments` sets `run` when it notes the deployment in the log.
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
  def place_schema, do: @place

  @spec new(module(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(module, opts) when is_atom(module) do
    with {:ok, opts} <- Options.validate(opts, @schema),
         :ok <- a_pipeline(module),
         :ok <- one_word(opts[:name]),
         {:ok, rules} <- rules(opts[:place], []) do
      {:ok,
       %__MODULE__{
         name: opts[:name] || module |> Module.split() |> List.last(),
         module: module,
         opts: opts[:opts],
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

  defp a_pipeline(module) do
    if Code.ensure_loaded?(module) and function_exported?(module, :build, 2),
      do: :ok,
      else:
        {:error,
         Error.new(:not_a_pipeline, "#{inspect(module)} is not a pipeline",
           why: "every node builds it by itself, so it is a module, not a function",
           fix: "use Situ.Pipeline in it, and have it on every node"
         )}
  end

  # Its log's subjects begin with it and a dot.
  defp one_word(name) do
    if is_binary(name) and (name == "" or String.contains?(name, ".")),
      do:
        {:error,
         Error.new(:bad_option, "a deployment's name has no dot: #{inspect(name)}",
           why: "in the log a dot divides it from the names of its streams",
           fix: "write - or _ instead"
         )},
      else: :ok
  end

  defp rules([], rules), do: {:ok, Enum.reverse(rules)}

  defp rules([{path, rule} | rest], rules) when is_binary(path) or path == :rest do
    with {:ok, rule} <- Options.validate(rule, @place) do
      rule = %{
        on: List.wrap(rule[:on]),
        only: rule[:only],
        deterministic: rule[:deterministic]
      }

      rules(rest, [{path, rule} | rules])
    end
  end

  defp rules([other | _], _rules) do
    {:error,
     Error.new(:bad_place, "no rule of place: #{inspect(other, limit: 5)}",
       fix: ~s(write {"Path", on: node} or {:rest, on: "label"})
     )}
  end
end
