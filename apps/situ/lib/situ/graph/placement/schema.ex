defmodule Situ.Graph.Placement.Schema do
  @moduledoc false
  # The schema of the options of `Situ.Graph.Placement`.
  alias Situ.{Delivery, Options}

  @policy {:optional, {:struct, Delivery}}
  @same_time "For two messages with one time: `:error`, `:drop` the second, or `:nudge` it to 1 ns after the first."

  @schema [
    name: [
      type: :string,
      doc:
        "Its name, unique in the pipeline. Default: the name of the component or operator, numbered if already in use."
    ],
    default_name: [type: :string, doc: false],
    type: [type: :any, doc: "Type of the output; see `Situ.Type`."],
    policy: [type: @policy, doc: "Delivery policy of its inputs. Default: the pipeline's policy."],
    async: [
      type: :boolean,
      default: false,
      doc:
        "Runs an operator in a separate process. For a component: keeps the operators after it out of its process."
    ],
    on_error: [
      type: {:in, [:stop, :skip, :restart]},
      default: :stop,
      doc:
        "Reaction to an exception: stop the pipeline, skip the message, or restart the component with a new state."
    ],
    check: [
      type: {:in, [:first, :all, :off]},
      default: :first,
      doc: "The messages of each input that are checked against its type."
    ],
    on_same_time: [type: {:in, [:error, :drop, :nudge]}, default: :error, doc: @same_time],
    inputs: [type: :keyword, doc: "Inputs, for components whose inputs vary."],
    outputs: [type: :keyword, doc: "Outputs, for components whose outputs vary."]
  ]

  @keys %{
    component: ~w(name default_name policy async on_error check on_same_time inputs outputs)a,
    fusion: ~w(name default_name type policies async on_error)a,
    operator: ~w(name default_name type policy async on_error)a,
    generator: ~w(name default_name type on_error on_same_time)a
  }

  @policies [
    type: {:or, [@policy, {:list, @policy}]},
    doc: "Delivery policy of its inputs, or a list with one policy per input, primary first."
  ]

  # Every component and operator of every branch needs a schema, so they are built once.
  @schemas Map.new(@keys, fn {kind, keys} ->
             {kind,
              Enum.map(keys, fn
                :policies -> {:policy, @policies}
                key -> {key, @schema[key]}
              end)}
           end)

  @spec options_for(Situ.Graph.Placement.kind()) :: Options.schema()
  def options_for(kind), do: Map.fetch!(@schemas, kind)
end
