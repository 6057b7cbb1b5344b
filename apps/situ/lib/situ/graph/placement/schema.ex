defmodule Situ.Graph.Placement.Schema do
  @moduledoc false
  # The one table of the options of `Situ.Graph.Placement`.
  alias Situ.{Delivery, Options}

  @policy {:optional, {:struct, Delivery}}
  @same_time "Two messages of one time: `:error`, `:drop` the later one, or `:nudge` it to 1 ns behind the other."

  @schema [
    name: [
      type: :string,
      doc:
        "Its name, unique in the pipeline; by default that of the component or operator, numbered where it is taken."
    ],
    default_name: [type: :string, doc: false],
    type: [type: :any, doc: "Type of the output, see `Situ.Type`."],
    policy: [type: @policy, doc: "Delivery policy of its inputs; by default the pipeline's."],
    async: [
      type: :boolean,
      default: false,
      doc:
        "Gives an operator a process of its own; of a component, that no operator behind it joins its process."
    ],
    on_error: [
      type: {:in, [:stop, :skip, :restart]},
      default: :stop,
      doc:
        "When it raises: stop the pipeline, skip the message, or restart the component with fresh state."
    ],
    check: [
      type: {:in, [:first, :all, :off]},
      default: :first,
      doc: "Which messages of an input are checked against its type."
    ],
    on_same_time: [type: {:in, [:error, :drop, :nudge]}, default: :error, doc: @same_time],
    inputs: [type: :keyword, doc: "Inputs, where they are known only now."],
    outputs: [type: :keyword, doc: "Outputs, where they are known only now."]
  ]

  @keys %{
    component: ~w(name default_name policy async on_error check on_same_time inputs outputs)a,
    fusion: ~w(name default_name type policies async on_error)a,
    operator: ~w(name default_name type policy async on_error)a,
    generator: ~w(name default_name type on_error on_same_time)a
  }

  @policies [
    type: {:or, [@policy, {:list, @policy}]},
    doc: "Delivery policy of its inputs, or a list of them, primary first."
  ]

  @spec of(Situ.Graph.Placement.kind()) :: Options.schema()
  def of(kind), do: Enum.map(Map.fetch!(@keys, kind), &entry/1)

  defp entry(:policies), do: {:policy, @policies}
  defp entry(key), do: {key, @schema[key]}
end
