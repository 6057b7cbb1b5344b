defmodule Situ.Parallel do
  @schema [
    size: [type: :pos_integer, doc: "Fixed form."],
    of: [type: {:in, [:lists, :maps]}, doc: "The form, where neither type nor function tell."],
    split: [type: {:fun, 1}, doc: "Makes the list or map of a message."],
    with: [type: {:fun, 1}, doc: "Makes the output of the list or map of results."],
    or_default: [type: :any, doc: "See above."],
    until: [
      type:
        {:or,
         [{:in, [:absent, :never]}, {:tuple, [{:in, [:absent]}, :non_neg_integer]}, {:fun, 3}]},
      default: :absent,
      doc: "See above."
    ],
    only_present: [
      type: :boolean,
      default: false,
      doc: "Maps: output only keys of the message, not all that are alive."
    ],
    on_branch_error: [type: {:in, [:stop, :restart]}, default: :stop, doc: "See above."],
    branches: [type: {:in, [:values, :processes]}, default: :values, doc: "See above."],
    branch_policy: [
      type: {:struct, Situ.Delivery},
      doc:
        "Of branches in processes: the delivery policy of the connections inside of them, which have none of their own."
    ]
  ]

  @moduledoc """
  The parts of each message through branches of their own, and the results back together.

      # Lists of a fixed or varying length: one branch per position.
      Situ.parallel(channels, fn channel -> Situ.average(channel, over: {:last, 10}) end)

      # Maps: one branch per key, for as long as the key is there.
      Situ.parallel(faces, fn id, face -> face |> Situ.map(& &1.mouth) |> Situ.delta() end)

      iex> inputs = [counts: [{0, %{ann: 1, bob: 5}}, {10, %{ann: 3}}]]
      iex> Situ.Test.run(inputs, fn s -> Situ.parallel(s.counts, fn _key, branch -> Situ.sum(branch) end) end)
      {:ok, [{0, %{ann: 1, bob: 5}}, {10, %{ann: 4}}]}

  The function builds a branch: a piece of pipeline, from a stream (or a key and a stream) to a stream. Each branch
  has its own state. Results come out at the message's time, as a list or a map like the input. Results of a branch
  at other times are dropped; when the function returns no stream, nothing comes out.

  | form | `stream` carries | branches | output |
  |---|---|---|---|
  | fixed, `size: n` | lists of n elements (another length is an error) | n | a list of n |
  | variable | lists | one per position, started by the first list that reaches it | a list as long as the input's |
  | sparse | maps, or what `split:` makes one of | one per key, started by its first message | a map of the live keys |

  When a branch has nothing at a time the whole output is dropped, or with `or_default: value` the value takes its
  place; a key that is kept alive without being in the message is such a case.

  ## When a key's branch ends

  | `until:` | ends | at the time of |
  |---|---|---|
  | `:absent` (default) | with the first message without the key | the last message with it |
  | `{:absent, n}` | with the message after `n` in a row without it | the last message it was alive in |
  | `:never` | with the stream | |
  | `fun.(key, map, time)` | when it answers `{:close, time}` and not `:keep`, asked with every message | what it says |

  Results that a branch gives while it ends (`Situ.last/2` ...) still count. Its state is released; the same key later
  begins a new branch.

  ## Values or processes

  By default a branch is a value inside the operator's process (see `Situ.Branch`): a hundred thousand of them are
  no burden, but they share one core, and hold nothing that has a clock or a process of its own. With `branches:
  :processes` each is a pipeline of its own, started at the time of its first part, with any component inside:
  sources, timers, delays, what is slow or talks to the world. Outputs, their times and their order are the same,
  wherever the branch itself is reproducible. Tens to thousands of such branches, not a hundred thousand.

      Situ.parallel(faces, fn _id, face -> Recognizer.who(face) end, branches: :processes)

  A time's output waits until each branch has given something for it, or something later, or has ended; a branch
  that is a straight run of light operators is known to give nothing as soon as it has handled the part. When
  some 256 outputs wait the input does, too, as long as a branch is at work. The operator is one box in the
  diagnostics, which tells how many branches live.

  ## When a branch fails

  It fails the operator as any other, named as `Parallel[key].Step`, and `on_error:` decides; a branch that is
  killed is such a failure. With `on_branch_error: :restart` that branch alone is restarted with its next part, and
  messages on their way through it count as missing.

  ## Options

  #{Situ.Options.docs(@schema)}

  and those of every operator (`Situ.Graph.Placement`).
  """

  alias Situ.Parallel.{Values, Processes, Termination}
  alias Situ.Graph.Placement
  alias Situ.{Argument, Operator, Stream}

  @no_queues "branch_policy: needs branches: :processes (a branch that is a value has no queues)"

  @doc """
  Branches by `fun`: see the forms above. Which form it is follows from the stream's type, `size:`, and the
  function: with a key as first argument it is sparse unless the type is a list. `of: :lists` or `of: :maps` says it
  where that is not enough.
  """
  @spec parallel(Stream.t(), (Stream.t() -> term()) | (term(), Stream.t() -> term()), keyword()) ::
          Stream.t()
  def parallel(stream, fun, opts \\ [])

  def parallel(%Stream{} = stream, fun, opts)
      when is_function(fun, 1) or is_function(fun, 2) do
    {own, placed} = Placement.split!(opts, @schema, :operator)
    form = form(stream.type, fun, own)
    options = [fun: fun, form: form, type: part(stream.type, own), missing: missing(own)]
    shared = Keyword.take(own, [:split, :with, :on_branch_error])
    processes? = own[:branches] == :processes
    if own[:branch_policy] && not processes?, do: raise(ArgumentError, @no_queues)
    shared = if processes?, do: Keyword.take(own, [:branch_policy]) ++ shared, else: shared
    options = options ++ shared ++ [termination: Termination.parse(own[:until])]
    type = if own[:with], do: :any, else: if(is_map_form(form), do: :map, else: :list)
    box = if processes?, do: Processes, else: Values
    Operator.through(stream, "Parallel", {box, options}, placed, type)
  end

  def parallel(other, _arg2, _arg3),
    do: Argument.refuse!(other, :stream, "Situ.parallel(stream, fn stream -> stream end)")

  defp form(type, fun, own) do
    cond do
      own[:size] -> {:fixed, own[:size]}
      own[:of] == :lists -> :variable
      own[:of] == :maps -> sparse(own)
      match?({:list, _}, type) or type == :list -> :variable
      match?({:map, _, _}, type) or type == :map -> sparse(own)
      is_function(fun, 2) -> sparse(own)
      true -> :variable
    end
  end

  defp sparse(own), do: if(own[:only_present], do: :present, else: :sparse)
  defp is_map_form(form), do: form in [:sparse, :present]

  defp part(type, own) do
    case {own[:split], type} do
      {nil, {:list, type}} -> type
      {nil, {:map, _key, type}} -> type
      _ -> :any
    end
  end

  defp missing(own) do
    case Keyword.fetch(own, :or_default) do
      {:ok, value} -> {:value, value}
      :error -> :drop
    end
  end
end
