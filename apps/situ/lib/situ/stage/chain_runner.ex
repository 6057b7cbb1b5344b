defmodule Situ.Stage.ChainRunner do
  @moduledoc false
  # Runs a batch of messages through a chain of light operators; each result gets one envelope, at the end.
  alias Situ.{Clock, Message}
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  alias Situ.Ports.{Counters, Input, Inputs, Output, Outputs}
  alias Situ.Stage.{ErrorPolicy, State}
  require Chain

  # So long a batch may take, looked at after every so many messages: an operator that becomes slow must not keep
  # requests waiting for many messages.
  @longest :erlang.convert_time_unit(5, :millisecond, :native)
  @every 4

  @doc """
  Runs the batch at clock time `now`. Returns the state, the last originating time, the number of handled messages, and
  the messages left over because the batch took too long.
  """
  @spec run_batch(State.t(), [Message.t()], Situ.Time.t(), integer()) ::
          {State.t(), integer(), non_neg_integer(), [Message.t()]}
  # So few are not worth a look at the time.
  def run_batch(state, [_] = messages, now, final), do: batch(state, messages, now, final, :never)

  def run_batch(state, [_, _] = messages, now, final),
    do: batch(state, messages, now, final, :never)

  def run_batch(state, messages, now, final),
    do: batch(state, messages, now, final, :erlang.monotonic_time() + @longest)

  defp batch(state, messages, now, final, till) do
    output = Outputs.last_output(state.outputs)
    {state, messages} = cut(state, messages, final)
    creation = if output.last_creation == nil, do: now, else: max(now, output.last_creation)

    out = %{
      seq: output.seq,
      id: output.port.source_id,
      now: creation,
      made: output.subs != [],
      till: till
    }

    {state, seq, reversed, last, n, rest} = go(state, messages, out)

    last_time = last || output.last_time
    output = %{output | seq: seq, last_creation: creation, last_time: last_time, posted: now}
    output = if out.made, do: Output.push_reversed(output, reversed, seq - out.seq), else: output
    {%{state | outputs: Outputs.put_last(state.outputs, output)}, last || now, n, rest}
  end

  @doc """
  Runs messages that a component has posted through the light operators after it in its process. There is no clock
  before the start, so messages that a source posts from `handle_start/2` wait for its first time slice. With `:some`,
  messages may be left for another time slice if handling takes too long; with `:all`, none are left.
  """
  @spec run_tail(State.t(), :some | :all) :: State.t()
  def run_tail(%{outputs: %{tail: nil}} = state, _much), do: state
  def run_tail(%{clock: nil} = state, _much), do: state
  def run_tail(%{phase: :starting} = state, _much), do: state
  # Its time slice is already scheduled.
  def run_tail(%{outputs: %{left: [_ | _]}, pace: %{scheduled: true}} = state, :some), do: state
  def run_tail(%{outputs: %{left: [], own: [{_, %{pending: []}}]}} = state, _much), do: state

  def run_tail(%{outputs: %{own: [{_name, output}]} = outputs} = state, much) do
    now = Clock.now(state.clock)
    fresh = :lists.reverse(output.pending)
    if fresh != [], do: Output.note_sent(output, hd(output.pending))
    emitted(state.chain, fresh, output.posted)
    messages = outputs.left ++ fresh
    outputs = Outputs.put(%{outputs | left: []}, %{output | pending: [], pending_n: 0})
    state = %{state | outputs: outputs}
    final = State.final_time(state)

    {state, last, n, left} =
      if much == :all,
        do: batch(state, messages, now, final, :never),
        else: run_batch(state, messages, now, final)

    handled(state.chain, n, last, now)
    %{state | outputs: %{state.outputs | left: left}}
  end

  defp emitted(%{counters: counters}, fresh, _posted) when counters == nil or fresh == [], do: :ok

  defp emitted(%{counters: counters, sizes: sizes}, fresh, posted) do
    %{originating_time: time, creation_time: created} = List.last(fresh)
    Counters.count_emitted(counters, length(fresh), created - time, posted - time)
    if sizes, do: Counters.count_sizes(counters, fresh)
    Counters.record_sent(counters, time, posted)
  end

  defp handled(%{counters: counters}, n, _last, _now) when counters == nil or n == 0, do: :ok

  defp handled(%{counters: counters}, n, last, now) do
    Counters.count_processed(counters, n, now - last, 0)
    Counters.record_reached(counters, last, now)
  end

  defp go(%{chain: %{fast: true, steps: steps}} = state, messages, out) do
    {seq, reversed, last, n, rest} = fast(messages, steps, out, out.seq, [], nil, 0, @every)
    resume(state, rest, out, {seq, reversed, last, n})
  end

  defp go(%{chain: chain} = state, messages, out) do
    {steps, seq, reversed, last, n, rest} =
      slow(messages, chain.steps, out, out.seq, [], nil, 0, @every)

    resume(%{state | chain: %{chain | steps: steps}}, rest, out, {seq, reversed, last, n})
  end

  defp resume(state, [], _out, {seq, reversed, last, n}), do: {state, seq, reversed, last, n, []}

  defp resume(state, {:late, rest}, _out, {seq, reversed, last, n}),
    do: {state, seq, reversed, last, n, rest}

  defp resume(state, {failure, message, rest}, out, {seq, reversed, last, n}) do
    state = failed(state, failure, message)

    if state.phase == :failed do
      state = drop(state, length(rest))
      {state, seq, reversed, message.originating_time, n + 1, []}
    else
      {state, seq, more, last2, n2, rest} = go(state, rest, %{out | seq: seq})
      {state, seq, more ++ reversed, last2 || last, n + 1 + n2, rest}
    end
  end

  # `k`: how many more messages until the next look at the time.
  defp fast([], _steps, _out, seq, acc, last, n, _k), do: {seq, acc, last, n, []}

  defp fast(messages, steps, out, seq, acc, last, n, 0) do
    if :erlang.monotonic_time() > out.till,
      do: {seq, acc, last, n, {:late, messages}},
      else: fast(messages, steps, out, seq, acc, last, n, @every)
  end

  defp fast([message | rest], steps, out, seq, acc, _last, n, k) do
    %{originating_time: time, data: data} = message

    case attempt(steps, data, message) do
      Chain.skip() ->
        fast(rest, steps, out, seq, acc, time, n + 1, k - 1)

      {:situ_step, _, _, _, _} = failure ->
        {seq, acc, time, n, {failure, message, rest}}

      data ->
        seq = seq + 1
        acc = if out.made, do: [envelope(data, time, seq, out) | acc], else: acc
        fast(rest, steps, out, seq, acc, time, n + 1, k - 1)
    end
  end

  defp slow([], steps, _out, seq, acc, last, n, _k), do: {steps, seq, acc, last, n, []}

  defp slow(messages, steps, out, seq, acc, last, n, 0) do
    if :erlang.monotonic_time() > out.till,
      do: {steps, seq, acc, last, n, {:late, messages}},
      else: slow(messages, steps, out, seq, acc, last, n, @every)
  end

  defp slow([message | rest], steps, out, seq, acc, _last, n, k) do
    %{originating_time: time, data: data} = message

    case attempt_stateful(steps, data, message) do
      {:situ_step, _, _, _, _} = failure ->
        {steps, seq, acc, time, n, {failure, message, rest}}

      {Chain.skip(), steps} ->
        slow(rest, steps, out, seq, acc, time, n + 1, k - 1)

      {data, steps} ->
        seq = seq + 1
        acc = if out.made, do: [envelope(data, time, seq, out) | acc], else: acc
        slow(rest, steps, out, seq, acc, time, n + 1, k - 1)
    end
  end

  defp envelope(data, time, seq, out) do
    %Message{
      data: data,
      originating_time: time,
      creation_time: out.now,
      sequence_id: seq,
      source_id: out.id
    }
  end

  defp attempt(steps, data, message) do
    Chain.run_stateless(steps, data, message)
  catch
    {:situ_step, _, _, _, _} = failure -> failure
  end

  defp attempt_stateful(steps, data, message) do
    Chain.run_stateful(steps, data, message)
  catch
    {:situ_step, _, _, _, _} = failure -> failure
  end

  defp failed(state, {_, index, kind, reason, stack}, message) do
    vertex = Enum.at(state.vertices, index)

    error =
      vertex.path
      |> Callback.exception_error(:in, kind, reason, stack)
      |> Callback.add_message_info(:in, message)

    case vertex.on_error do
      :stop ->
        ErrorPolicy.fail_stage(state, error)

      :skip ->
        ErrorPolicy.skip_message(state, error, index)

      :restart ->
        state = ErrorPolicy.record_restart(state, error, index)
        %{state | chain: Chain.replace_step(state.chain, index, vertex.opts)}
    end
  end

  defp cut(state, messages, final) do
    if final == State.no_final_time() do
      {state, messages}
    else
      {kept, late} = Enum.split_while(messages, &(&1.originating_time <= final))
      {drop(state, length(late)), kept}
    end
  end

  # A discarded message still counts as taken, so that the producer gets its demand back.
  defp drop(state, 0), do: state

  defp drop(%{callback: nil} = state, n) do
    input = Inputs.single_input(state.inputs)
    %{state | inputs: Inputs.put(state.inputs, Input.drop_taken(input, n))}
  end

  defp drop(%{chain: %{counters: nil}} = state, _n), do: state

  defp drop(%{chain: %{counters: counters}} = state, n) do
    Counters.count_dropped(counters, n)
    state
  end
end
