defmodule Situ.Parallel do
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
      doc: "When the branch of a key ends; see above."
    ],
    only_present: [
      type: :boolean,
      default: false,
      doc: "For maps: outputs only the keys in the message, not all live keys."
    ],
    on_branch_error: [type: {:in, [:stop, :restart]}, default: :stop, doc: "See above."],
    branches: [type: {:in, [:values, :processes]}, default: :values, doc: "How branches run."],
    branch_policy: [
      type: {:struct, Situ.Delivery},
      doc:
        "For branches in processes: the delivery policy of their inner connections that do not set one."
    ]
  ]

  @moduledoc """
  Sends the parts of each message through separate branches, and recombines the results.

      # Lists of a fixed or varying length: one branch per position.
      Situ.parallel(channels, fn channel -> Situ.average(channel, over: {:last, 10}) end)

      # Maps: one branch per key, as long as the key is present.
      Situ.parallel(faces, fn id, face -> face |> Situ.map(& &1.mouth) |> Situ.delta() end)

      iex> inputs = [counts: [{0, %{ann: 1, bob: 5}}, {10, %{ann: 3}}]]
      iex> Situ.Test.run(inputs, fn s -> Situ.parallel(s.counts, fn _key, branch -> Situ.sum(branch) end) end)
      {:ok, [{0, %{ann: 1, bob: 5}}, {10, %{ann: 4}}]}

  The function builds a branch, which is a part of a pipeline from a stream (or a key and a stream) to a stream. Each
  branch has its own state. Results are emitted at the message's time, as a list or a map like the input. Results of a
  branch at other times are dropped. If the function does not return a stream, the operator has no output.

  | form | input | branches | output |
  |---|---|---|---|
  | fixed, `size: n` | lists of n elements (other lengths are errors) | n | a list of n |
  | variable | lists | one per position, started by the first list that long | a list as long as the input's |
  | sparse | maps, or data with `split:` | one per key, started by its first message | a map of the live keys |

  If a branch has no result at a time, the complete output is dropped. With `or_default: value`, the value is used
  instead. One such case is a key that is kept alive without being in the message.

  ## When a key's branch ends

  | `until:` | the branch ends | at the time of |
  |---|---|---|
  | `:absent` (default) | with the first message without the key | the last message with it |
  | `{:absent, n}` | with the message after `n` in a row without it | the last message at which it was alive |
  | `:never` | with the stream | |
  | `fun.(key, map, time)` | when it returns `{:close, time}` (called with every message; else `:keep`) | `time` |

  Results that a branch emits while it ends (`Situ.last/2` ...) still count. Its state is released, and the same key
  later starts a new branch.

  ## Values or processes

  By default a branch is a value inside the operator's process (see `Situ.Branch`). A hundred thousand of them are no
  problem, but they share one core, and may not contain components with a clock or a process. With `branches:
  :processes`, each branch is a separate pipeline, started at the time of its first part. It may contain any component,
  such as sources, timers, delays, and components that are slow or do I/O. Outputs, their times and their order are the
  same, as long as the branch itself is reproducible. Use this for tens to thousands of branches.

      Situ.parallel(faces, fn _id, face -> Recognizer.who(face) end, branches: :processes)

  The output of a time waits until each branch has emitted a result for it or for a later time, or has ended. A branch
  that is a linear chain of light operators is known to have no result as soon as it has handled the part. When about
  256 outputs are waiting, the input waits too, as long as a branch is working. The operator is one box in the
  diagnostics, which shows the number of live branches.

  ## When a branch fails

  A branch that fails, or is killed, fails the operator like any other error, with a name such as `Parallel[key].Step`,
  and `on_error:` decides. With `on_branch_error: :restart`, only that branch is restarted with its next part, and
  messages in flight in it count as missing.

  ## Options

  #{Situ.Options.docs(@schema)}

  All options of every operator also apply (`Situ.Graph.Placement`).
  """

  alias Situ.Parallel.{Values, Processes, Termination}
  alias Situ.Graph.Placement
  alias Situ.{Argument, Operator, Stream}

  @no_queues "branch_policy: needs branches: :processes (branches that run as values have no queues)"

  @doc """
  Builds a branch for each part with `fun`, in the forms above. The form follows from the stream's type, `size:`, and
  the function. A function with a key as its first argument means sparse, unless the type is a list. `of: :lists` or
  `of: :maps` sets the form explicitly.
  """
  @spec parallel(Stream.t(), (Stream.t() -> term()) | (term(), Stream.t() -> term()), keyword()) ::
          Stream.t()
  def parallel(stream, fun, opts \\ [])

  def parallel(%Stream{} = stream, fun, opts)
      when is_function(fun, 1) or is_function(fun, 2) do
    {own, placed} = Placement.split_options!(opts, @schema, :operator)
    form = choose_form(stream.type, fun, own)

    options = [
      fun: fun,
      form: form,
      type: part_type(stream.type, own),
      missing: parse_missing(own)
    ]

    shared = Keyword.take(own, [:split, :with, :on_branch_error])
    processes? = own[:branches] == :processes
    if own[:branch_policy] && not processes?, do: raise(ArgumentError, @no_queues)
    shared = if processes?, do: Keyword.take(own, [:branch_policy]) ++ shared, else: shared
    options = options ++ shared ++ [termination: Termination.parse_rule(own[:until])]
    type = if own[:with], do: :any, else: if(is_map_form(form), do: :map, else: :list)
    box = if processes?, do: Processes, else: Values
    Operator.attach_component(stream, "Parallel", {box, options}, placed, type)
  end

  def parallel(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.parallel(stream, fn stream -> stream end)")

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
