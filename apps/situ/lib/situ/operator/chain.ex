defmodule Situ.Operator.Chain do
  @moduledoc false
  # A chain of light operators in one process. Only the data moves from operator to operator; the caller adds the
  # envelopes at the end. Operators without state are composed into one function. An operator that raises is identified
  # by its index, so that the error names the operator that the user wrote.
  alias Situ.{Columns, Message}
  alias Situ.Delivery.Batch

  @type step ::
          {atom(), fun(), index :: non_neg_integer()}
          | {atom(), fun(), index :: non_neg_integer(), term()}
  @type steps :: [step()]
  @type failure ::
          {:situ_step, index :: non_neg_integer(), :error | :exit | :throw, term(), list()}
  @skip :"$situ_skip"
  # The time is checked after this many messages: an operator that becomes slow must not keep requests waiting for many.
  @check_every 4
  # So many values of columns become messages together. If the time is up, the others have cost nothing: next to many
  # busy processes, that is the case after a few messages.
  @unpacked_together 256

  @doc "Returns how many messages a chain handles before it notes its progress for log lines."
  @spec messages_per_note() :: pos_integer()
  def messages_per_note, do: @check_every

  @enforce_keys [:steps]
  defstruct [:steps, :composed, takes_message?: false, skips?: false]

  @typedoc """
  `composed` is the function of all operators if none keeps state. `takes_message?` is true if an operator needs the
  envelope, `skips?` if one may drop messages.
  """
  @type t :: %__MODULE__{
          steps: steps(),
          composed: (term(), Message.t() | nil -> term()) | nil,
          takes_message?: boolean(),
          skips?: boolean()
        }

  @doc "Compiles the operators of `vertices`, which start at index `first` of their stage."
  @spec compile([Situ.Graph.Vertex.t()], non_neg_integer()) :: t()
  def compile(vertices, first),
    do: vertices |> Enum.map(& &1.opts) |> build_steps(first) |> compile_steps()

  defp compile_steps(steps) do
    stateful? = stateful?(steps)

    %__MODULE__{
      steps: steps,
      composed: if(stateful?, do: nil, else: compose(steps)),
      takes_message?: stateful? or Enum.any?(steps, &(elem(&1, 0) in [:map2, :filter2, :each2])),
      skips?: stateful? or Enum.any?(steps, &(elem(&1, 0) in [:filter, :filter2]))
    }
  end

  @doc "Updates the steps of the chain with `fun`."
  @spec update_steps(t(), (steps() -> steps())) :: t()
  def update_steps(%__MODULE__{steps: steps}, fun), do: compile_steps(fun.(steps))

  @doc """
  Replaces the step of the operator at `index`. The state of the old step is discarded, or kept with `{:keep, step}`.
  """
  @spec replace_step(t(), non_neg_integer(), Situ.Operator.step() | {:keep, Situ.Operator.step()}) ::
          t()
  def replace_step(chain, index, {:keep, {:step, fun, _state}}) do
    update_steps(chain, fn steps ->
      Enum.map(steps, fn
        {:step, _old, ^index, state} -> {:step, fun, index, state}
        other -> other
      end)
    end)
  end

  def replace_step(chain, index, {:keep, step}), do: replace_step(chain, index, step)

  def replace_step(chain, index, step) do
    [fresh] = build_steps([step], index)

    update_steps(chain, fn steps ->
      Enum.map(steps, &if(elem(&1, 2) == index, do: fresh, else: &1))
    end)
  end

  @doc "Builds the steps of operators, in order; `first` is the index of the first operator's vertex in its stage."
  @spec build_steps([Situ.Operator.step()], non_neg_integer()) :: steps()
  def build_steps(steps, first \\ 0) do
    steps
    |> Enum.with_index(first)
    |> Enum.map(fn
      {{:step, fun, state}, i} -> {:step, fun, i, state}
      {{kind, fun}, i} -> {step_kind(kind, fun), fun, i}
    end)
  end

  @doc "Returns whether any step keeps state."
  @spec stateful?(steps()) :: boolean()
  def stateful?(steps), do: Enum.any?(steps, &(tuple_size(&1) == 4))

  @doc """
  Runs a batch through the chain until the monotonic time `till`. Returns the results of the messages handled, some of
  them `skip/0`, the chain, and `:late` or the failure that ended the run before the last message.
  """
  @spec run_batch(t(), Batch.t(), integer()) :: {[term()], t(), :done | :late | failure()}
  def run_batch(%__MODULE__{} = chain, %Columns{count: count} = columns, till)
      when count > @unpacked_together,
      do: run_parts(chain, columns, till, [])

  def run_batch(%__MODULE__{takes_message?: false} = chain, batch, till) do
    {results, outcome} = run_data(Batch.data(batch), chain.composed, till, [])
    {:lists.reverse(results), chain, outcome}
  end

  def run_batch(%__MODULE__{} = chain, batch, till),
    do: run_messages(Batch.messages(batch), chain, till, [])

  defp run_parts(chain, columns, till, before) do
    {part, rest} = Batch.split(columns, @unpacked_together)

    with {path, _all} <- Process.get(:situ_handling),
         do: Process.put(:situ_handling, {path, part})

    {results, chain, outcome} = run_batch(chain, part, till)
    before = [results | before]

    if outcome == :done and rest != nil,
      do: run_parts(chain, rest, till, before),
      else: {before |> :lists.reverse() |> :lists.append(), chain, outcome}
  end

  # `:situ_left` and `:situ_handling` are for log lines: see `Situ.Component.LogContext`.
  defp run_data(data, fun, till, results) do
    Process.put(:situ_left, data)

    case run_some(data, fun, results, @check_every) do
      {[], results} ->
        {results, :done}

      {{:situ_step, _, _, _, _} = failure, results} ->
        {results, failure}

      {rest, results} ->
        if :erlang.monotonic_time(:nanosecond) > till,
          do: {results, :late},
          else: run_data(rest, fun, till, results)
    end
  end

  defp run_some([data | rest], fun, results, count) when count > 0 do
    case fun.(data, nil) do
      {:situ_step, _, _, _, _} = failure -> {failure, results}
      result -> run_some(rest, fun, [result | results], count - 1)
    end
  end

  defp run_some(rest, _fun, results, _count), do: {rest, results}

  defp run_messages(messages, chain, till, results) do
    Process.put(:situ_left, messages)

    case run_some_messages(messages, chain, results, @check_every) do
      {[], chain, results} ->
        {:lists.reverse(results), chain, :done}

      {{:situ_step, _, _, _, _} = failure, chain, results} ->
        {:lists.reverse(results), chain, failure}

      {rest, chain, results} ->
        if :erlang.monotonic_time(:nanosecond) > till,
          do: {:lists.reverse(results), chain, :late},
          else: run_messages(rest, chain, till, results)
    end
  end

  defp run_some_messages([message | rest], %{composed: nil} = chain, results, count)
       when count > 0 do
    case attempt_stateful(chain.steps, message) do
      {:situ_step, _, _, _, _} = failure ->
        {failure, chain, results}

      {result, steps} ->
        run_some_messages(rest, %{chain | steps: steps}, [result | results], count - 1)
    end
  end

  defp run_some_messages([message | rest], chain, results, count) when count > 0 do
    case chain.composed.(message.data, message) do
      {:situ_step, _, _, _, _} = failure -> {failure, chain, results}
      result -> run_some_messages(rest, chain, [result | results], count - 1)
    end
  end

  defp run_some_messages(rest, chain, results, _count), do: {rest, chain, results}

  defp attempt_stateful(steps, message) do
    run_stateful(steps, message.data, message)
  catch
    {:situ_step, _, _, _, _} = failure -> failure
  end

  @doc """
  Composes steps without state into one function of the data and the message, which returns data, `skip/0` or a failure.
  """
  @spec compose(steps()) :: (term(), Message.t() | nil -> term() | failure())
  def compose([]), do: fn data, _message -> data end
  def compose([step]), do: compose_step(step, nil)
  def compose([step | rest]), do: compose_step(step, compose(rest))

  # The most frequent steps are written out, because a message passes through them in a few calls.
  defp compose_step({:map, fun, i}, nil) do
    fn data, _message ->
      try do
        fun.(data)
      catch
        kind, reason -> {:situ_step, i, kind, reason, __STACKTRACE__}
      end
    end
  end

  defp compose_step({:map, fun, i}, next) do
    fn data, message ->
      try do
        fun.(data)
      catch
        kind, reason -> {:situ_step, i, kind, reason, __STACKTRACE__}
      else
        data -> next.(data, message)
      end
    end
  end

  defp compose_step({:each, fun, i}, nil) do
    fn data, _message ->
      try do
        fun.(data)
        data
      catch
        kind, reason -> {:situ_step, i, kind, reason, __STACKTRACE__}
      end
    end
  end

  defp compose_step(step, nil), do: compose_step(step, fn data, _message -> data end)

  defp compose_step({kind, _fun, _i} = step, next)
       when kind in [:map2, :filter, :filter2, :each, :each2] do
    fn data, message ->
      case apply_step(step, data, message) do
        {:emit, data} -> next.(data, message)
        skip_or_failure -> skip_or_failure
      end
    end
  end

  @doc "Runs stateless steps on a message; returns data or `skip/0`. Throws a failure."
  @spec run_stateless(steps(), term(), Message.t()) :: term()
  def run_stateless([], data, _message), do: data

  def run_stateless([step | rest], data, message) do
    case apply_step(step, data, message) do
      {:emit, value} -> run_stateless(rest, value, message)
      @skip -> @skip
      failure -> throw(failure)
    end
  end

  @doc "Runs steps with state on a message; returns `{data | skip, steps}`. Throws a failure."
  @spec run_stateful(steps(), term(), Message.t()) :: {term(), steps()}
  def run_stateful([], data, _message), do: {data, []}

  def run_stateful([{:step, fun, i, state} | rest], data, message) do
    result =
      try do
        fun.(data, message, state)
      catch
        kind, reason -> throw({:situ_step, i, kind, reason, __STACKTRACE__})
      end

    case result do
      {:emit, value, state} ->
        {out, rest} = run_stateful(rest, value, message)
        {out, [{:step, fun, i, state} | rest]}

      {:skip, state} ->
        {@skip, [{:step, fun, i, state} | rest]}

      other ->
        throw({:situ_step, i, :error, bad_return_error(other), []})
    end
  end

  def run_stateful([step | rest], data, message) do
    case apply_step(step, data, message) do
      {:emit, value} ->
        {out, rest} = run_stateful(rest, value, message)
        {out, [step | rest]}

      @skip ->
        {@skip, [step | rest]}

      failure ->
        throw(failure)
    end
  end

  @doc "Returns the marker for an empty result: the step emits nothing."
  defmacro skip, do: @skip

  defp apply_step({kind, fun, i}, data, message) do
    case kind do
      :map -> {:emit, fun.(data)}
      :map2 -> {:emit, fun.(data, message)}
      :filter -> if fun.(data), do: {:emit, data}, else: @skip
      :filter2 -> if fun.(data, message), do: {:emit, data}, else: @skip
      :each -> emit_data(fun.(data), data)
      :each2 -> emit_data(fun.(data, message), data)
    end
  catch
    kind, reason -> {:situ_step, i, kind, reason, __STACKTRACE__}
  end

  defp emit_data(_result, data), do: {:emit, data}

  defp step_kind(kind, fun) when is_function(fun, 1), do: kind
  defp step_kind(:map, _fun), do: :map2
  defp step_kind(:filter, _fun), do: :filter2
  defp step_kind(:each, _fun), do: :each2

  defp bad_return_error(other) do
    ArgumentError.exception(
      "a step must return {:emit, data, state} or {:skip, state}, got: #{inspect(other, limit: 8)}"
    )
  end
end
