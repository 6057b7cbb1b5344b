defmodule Situ.Parallel do
  @moduledoc false
  # Sends the parts of each message through separate branches, and recombines the results. `Situ.parallel/3` documents
  # the operator, `Situ.Parallel.Component` runs it.

  @schema [
    size: [type: :pos_integer, doc: "Number of branches, for the fixed form."],
    of: [
      type: {:in, [:lists, :maps]},
      doc: "The form, if neither the type nor the function determines it."
    ],
    split: [type: {:fun, 1}, doc: "Builds the list or map of parts from a message's data."],
    with: [type: {:fun, 1}, doc: "Builds the output from the list or map of results."],
    or_default: [type: :any, doc: "Replaces a missing result."],
    until: [
      type:
        {:or,
         [{:in, [:absent, :never]}, {:tuple, [{:in, [:absent]}, :non_neg_integer]}, {:fun, 3}]},
      default: :absent,
      doc: "When the branch of a key ends; see the table."
    ],
    only_present: [
      type: :boolean,
      default: false,
      doc: "For maps: outputs only the keys in the message, not all live keys."
    ],
    on_branch_error: [
      type: {:in, [:stop, :restart]},
      default: :stop,
      doc: "Whether a branch that fails stops the operator, or restarts alone."
    ],
    branches: [
      type: {:or, [{:in, [:values, :processes]}, {:tuple, [{:in, [:nodes]}, {:fun, 1}]}]},
      default: :values,
      doc:
        "How branches run: `:values`, `:processes`, or `{:nodes, fun}`, where `fun.(key)` returns the branch's node."
    ],
    branch_policy: [
      type: {:struct, Situ.Delivery},
      doc:
        "For branches in processes: the delivery policy of their inner connections that do not set one."
    ]
  ]

  alias Situ.Graph.Placement
  alias Situ.{Argument, Operator, Stream}
  alias Situ.Parallel.{Component, Processes, Termination, Values}

  @no_queues "branch_policy: needs branches: :processes or {:nodes, fun} (branches that are values have no queues)"

  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  def parallel(%Stream{} = stream, fun, opts)
      when is_function(fun, 1) or is_function(fun, 2) do
    {own, placement} = Placement.split_options!(opts, @schema, :operator)
    form = choose_form(stream.type, fun, own)

    type = if own[:with], do: :any, else: if(is_map_form(form), do: :map, else: :list)

    options =
      [
        fun: fun,
        form: form,
        type: part_type(stream.type, own),
        missing: parse_missing(own),
        termination: Termination.parse_rule(own[:until])
      ] ++ strategy_options(own) ++ Keyword.take(own, [:split, :with, :on_branch_error])

    Operator.attach_component(stream, "Parallel", {Component, options}, placement, type)
  end

  def parallel(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.parallel(stream, fn stream -> stream end)")

  defp strategy_options(own) do
    case own[:branches] do
      :values ->
        if own[:branch_policy], do: raise(ArgumentError, @no_queues), else: [strategy: Values]

      :processes ->
        [strategy: Processes] ++ Keyword.take(own, [:branch_policy])

      {:nodes, choose_node} ->
        [choose_node: choose_node] ++ strategy_options([branches: :processes] ++ own)
    end
  end

  defp choose_form(type, fun, own) do
    cond do
      own[:size] -> {:fixed, own[:size]}
      own[:of] == :lists -> :variable
      own[:of] == :maps -> sparse_or_present(own)
      match?({:list, _}, type) or type == :list -> :variable
      match?({:map, _, _}, type) or type == :map -> sparse_or_present(own)
      is_function(fun, 2) -> sparse_or_present(own)
      true -> :variable
    end
  end

  defp sparse_or_present(own), do: if(own[:only_present], do: :present, else: :sparse)
  defp is_map_form(form), do: form in [:sparse, :present]

  defp part_type(type, own) do
    case {own[:split], type} do
      {nil, {:list, type}} -> type
      {nil, {:map, _key, type}} -> type
      _ -> :any
    end
  end

  defp parse_missing(own) do
    case Keyword.fetch(own, :or_default) do
      {:ok, value} -> {:value, value}
      :error -> :drop
    end
  end
end
