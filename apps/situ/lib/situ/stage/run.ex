defmodule Situ.Stage.Run do
  @moduledoc false
  # A batch of messages through a chain of light operators: one envelope at the end for each that comes through.
  alias Situ.{Message, Stage}
  alias Situ.Operator.Chain
  alias Situ.Stage.{Call, Counters, Fault, Marks, Outlet, Tally}
  require Chain

  @doc "Runs the batch; answers the state, the last originating time, and how many messages were handled."
  @spec batch(Stage.t(), [Message.t()], Situ.Time.t(), integer()) ::
          {Stage.t(), integer(), non_neg_integer()}
  def batch(state, messages, now, final) do
    [{name, _}] = Map.to_list(state.outlets)
    through(state, name, messages, now, final)
  end

  @doc "Runs what a component has posted through the light operators behind it in its process."
  @spec tail(Stage.t(), Situ.Time.t(), integer()) :: Stage.t()
  def tail(%{tail: %{chain: chain, fast: fast, counters: counters}} = state, now, final) do
    {name, outlet} = Enum.find(state.outlets, fn {key, _} -> is_atom(key) end)
    messages = :lists.reverse(outlet.pending)
    Marks.put(outlet.mark, hd(outlet.pending))
    outlets = %{state.outlets | name => %{outlet | pending: [], pending_n: 0}}
    state = %{state | outlets: outlets, chain: chain, fast: fast}
    [key] = for {{:tail, _} = key, _} <- outlets, do: key
    {state, last, n} = through(state, key, messages, now, final)
    if counters, do: count(state.tail, messages, outlet.posted, {n, now - last})
    %{state | tail: %{state.tail | chain: state.chain}, chain: nil}
  end

  defp count(%{counters: counters, sizes: sizes}, messages, posted, {n, latency}) do
    %{originating_time: time, creation_time: created} = List.last(messages)
    Counters.emitted(counters, length(messages), created - time, posted - time)
    if sizes, do: Counters.sized(counters, messages)
    if n > 0, do: Counters.processed(counters, n, latency, 0)
  end

  defp through(state, name, messages, now, final) do
    outlet = Map.fetch!(state.outlets, name)

    {state, messages} =
      if final == Stage.never(), do: {state, messages}, else: cut(state, messages, final)

    creation = if outlet.last_creation == nil, do: now, else: max(now, outlet.last_creation)
    out = %{seq: outlet.seq, id: outlet.source_id, now: creation, made: outlet.subs != []}
    {state, seq, reversed, last, n} = go(state, messages, out)

    last_time = last || outlet.last_time
    outlet = %{outlet | seq: seq, last_creation: creation, last_time: last_time, posted: now}
    outlet = if out.made, do: Outlet.push_reversed(outlet, reversed, seq - out.seq), else: outlet
    {%{state | outlets: %{state.outlets | name => outlet}}, last || now, n}
  end

  defp go(%{fast: true} = state, messages, out) do
    {seq, reversed, last, n, rest} = fast(messages, state.chain, out, out.seq, [], nil, 0)
    resume(state, rest, out, {seq, reversed, last, n})
  end

  defp go(state, messages, out) do
    {chain, seq, reversed, last, n, rest} = slow(messages, state.chain, out, out.seq, [], nil, 0)
    resume(%{state | chain: chain}, rest, out, {seq, reversed, last, n})
  end

  defp resume(state, [], _out, {seq, reversed, last, n}), do: {state, seq, reversed, last, n}

  defp resume(state, {failure, message, rest}, out, {seq, reversed, last, n}) do
    state = failed(state, failure, message)

    if state.failed do
      state = drop(state, length(rest))
      {state, seq, reversed, message.originating_time, n + 1}
    else
      {state, seq, more, last2, n2} = go(state, rest, %{out | seq: seq})
      {state, seq, more ++ reversed, last2 || last, n + 1 + n2}
    end
  end

  defp fast([], _chain, _out, seq, acc, last, n), do: {seq, acc, last, n, []}

  defp fast([message | rest], chain, out, seq, acc, _last, n) do
    %{originating_time: time, data: data} = message

    case attempt(chain, data, message) do
      Chain.skip() ->
        fast(rest, chain, out, seq, acc, time, n + 1)

      {:situ_step, _, _, _, _} = failure ->
        {seq, acc, time, n, {failure, message, rest}}

      data ->
        seq = seq + 1
        acc = if out.made, do: [envelope(data, time, seq, out) | acc], else: acc
        fast(rest, chain, out, seq, acc, time, n + 1)
    end
  end

  defp slow([], chain, _out, seq, acc, last, n), do: {chain, seq, acc, last, n, []}

  defp slow([message | rest], chain, out, seq, acc, _last, n) do
    %{originating_time: time, data: data} = message

    case attempt_stateful(chain, data, message) do
      {:situ_step, _, _, _, _} = failure ->
        {chain, seq, acc, time, n, {failure, message, rest}}

      {Chain.skip(), chain} ->
        slow(rest, chain, out, seq, acc, time, n + 1)

      {data, chain} ->
        seq = seq + 1
        acc = if out.made, do: [envelope(data, time, seq, out) | acc], else: acc
        slow(rest, chain, out, seq, acc, time, n + 1)
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

  defp attempt(chain, data, message) do
    Chain.run(chain, data, message)
  catch
    {:situ_step, _, _, _, _} = failure -> failure
  end

  defp attempt_stateful(chain, data, message) do
    Chain.run_stateful(chain, data, message)
  catch
    {:situ_step, _, _, _, _} = failure -> failure
  end

  defp failed(state, {_, index, kind, reason, stack}, message) do
    vertex = Enum.at(state.vertices, index)
    error = vertex.path |> Call.failure(:in, kind, reason, stack) |> Call.at(:in, message)

    case vertex.on_error do
      :stop ->
        Fault.fail(state, error)

      :skip ->
        Tally.skipped(state.tally, index)
        tell(state, error)

      :restart ->
        Tally.restarted(state.tally, index)

        chain =
          Enum.map(state.chain, &if(elem(&1, 2) == index, do: fresh(state, index), else: &1))

        tell(%{state | chain: chain}, error)
    end
  end

  defp fresh(state, index),
    do: [Enum.at(state.vertices, index).opts] |> Chain.new(index) |> hd()

  defp tell(state, error) do
    send(state.server, {:situ_stage, state.id, {:skipped, error}})
    state
  end

  defp cut(state, messages, final) do
    {kept, late} = Enum.split_while(messages, &(&1.originating_time <= final))
    {drop(state, length(late)), kept}
  end

  # What is thrown away still counts as taken, so that the producer gets its demand back.
  defp drop(%{kind: :component, tail: %{counters: counters}} = state, n) do
    if counters && n > 0, do: Counters.dropped(counters, n)
    state
  end

  defp drop(state, n) do
    [{tag, inlet}] = Map.to_list(state.inlets)
    Situ.Stage.Inlet.drop(inlet, n)
    owed = if inlet.lossy, do: 0, else: n
    %{state | inlets: %{tag => %{inlet | owed: inlet.owed + owed}}}
  end
end
