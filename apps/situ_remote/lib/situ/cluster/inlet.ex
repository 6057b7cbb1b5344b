defmodule Situ.Cluster.Inlet do
  @moduledoc false
  # A stream of another part, wherever that runs: the consumer's side of a GenStage edge to its publisher. It knows
  # how far it has come; when the publisher is lost it waits for the next one and goes on from there. A direct stream
  # goes on with what is made then: its messages are told by their times, and numbered here.
  use Situ.Component,
    outputs: [out: :any],
    options: [
      agent: [type: :any, required: true],
      part: [type: :any, required: true],
      stream: [type: :string, required: true],
      direct: [type: :boolean, default: false],
      reader: [type: :string, default: ""]
    ]

  alias Situ.Cluster.{Batch, Member}
  alias Situ.Error

  # As many messages as weigh so much are under way at once, between these numbers.
  @bytes 12 * 1024 * 1024
  @least 4
  @most 4_000

  @impl true
  def init(opts) do
    {:ok, Map.merge(Map.new(opts), %{last: 0, made: 0, time: nil, sub: nil})}
  end

  @impl true
  def handle_start(_context, state) do
    Member.follow(state.agent, state.part)
    {[], state}
  end

  @impl true
  def snapshot(state), do: {:ok, Map.take(state, [:last, :made, :time])}
  @impl true
  def restore(mark, fresh), do: {:ok, Map.merge(fresh, mark)}

  # There is room: what was taken is asked for again, as soon as it is half of the window.
  @impl true
  def handle_demand(_n, _context, %{sub: %{asked: asked, window: window} = sub} = state)
      when asked <= div(window, 2) do
    send(sub.pid, {:"$gen_producer", {self(), sub.ref}, {:ask, window - asked}})
    {[], %{state | sub: %{sub | asked: window}}}
  end

  def handle_demand(_n, _context, state), do: {[], state}

  @impl true
  def handle_info({:situ_cluster, :publisher, _part, pid}, _context, %{sub: %{pid: pid}} = state),
    do: {[], state}

  def handle_info({:situ_cluster, :publisher, part, pid}, _context, %{part: part} = state),
    do: {[], state |> leave() |> subscribe(pid)}

  def handle_info({:"$gen_consumer", {_, ref}, {:cancel, reason}}, _context, state)
      when state.sub.ref == ref do
    case reason do
      {:shutdown, {:closed, time}} -> {[{:close, :out, time}], leave(state)}
      _ -> {[], leave(state)}
    end
  end

  # As it was packed for the log.
  def handle_info({:"$gen_consumer", {_, ref} = from, {:situ_batch, first, body}}, context, state)
      when state.sub.ref == ref,
      do: handle_info({:"$gen_consumer", from, unpacked(body, first)}, context, state)

  def handle_info({:"$gen_consumer", {_, ref}, messages}, _context, %{direct: true} = state)
      when state.sub.ref == ref and is_list(messages) and messages != [] do
    sub = %{state.sub | asked: state.sub.asked - length(messages), window: window(messages)}
    fresh = Enum.drop_while(messages, &(state.time != nil and &1.originating_time <= state.time))

    {fresh, {last, made, time}} =
      Enum.map_reduce(fresh, {state.last, state.made, state.time}, fn m, {last, made, _} ->
        {m, made} = made(m, made)
        {%{m | sequence_id: last + 1}, {last + 1, made, m.originating_time}}
      end)

    state = %{state | sub: sub, last: last, made: made, time: time}
    {if(fresh == [], do: [], else: [{:out, fresh}]), state}
  end

  def handle_info({:"$gen_consumer", {_, ref}, messages}, _context, state)
      when state.sub.ref == ref and is_list(messages) and messages != [] do
    sub = %{state.sub | asked: state.sub.asked - length(messages), window: window(messages)}

    case Enum.drop_while(messages, &(&1.sequence_id <= state.last)) do
      [] ->
        {[], %{state | sub: sub}}

      [%{sequence_id: id} | _] when id > state.last + 1 ->
        raise trimmed(state, id)

      fresh ->
        {fresh, made} = Enum.map_reduce(fresh, state.made, &made/2)
        {[{:out, fresh}], %{state | sub: sub, last: List.last(fresh).sequence_id, made: made}}
    end
  end

  def handle_info({:DOWN, ref, :process, _, _}, _context, state) when state.sub.ref == ref,
    do: {[], %{state | sub: nil}}

  def handle_info(_other, _context, state), do: {[], state}

  defp unpacked(body, first), do: body |> Batch.rows() |> Batch.messages(first)

  # Numbers of a stream have no gaps: what lies between is not in the log any more.
  defp trimmed(state, id) do
    Error.new(:log_trimmed, "the log lacks #{id - state.last - 1} messages of #{state.stream}",
      why: "they were trimmed before this part had them",
      fix:
        "give the deployment a longer retain:, or checkpoints to the part's components (snapshot/1)"
    )
  end

  # A deterministic part repeats its messages with new creation times, and this inlet may have seen some of them:
  # creation times must not go back.
  defp made(%{creation_time: time} = message, made) when time >= made, do: {message, time}
  defp made(message, made), do: {%{message | creation_time: made}, made}

  @impl true
  def terminate(_reason, state), do: leave(state)

  defp subscribe(state, pid) do
    ref = Process.monitor(pid)
    opts = [stream: state.stream, from: state.last, part: state.part, reader: state.reader]
    opts = [{:batches, true}, {:time, state.time} | opts]
    send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, opts}})
    send(pid, {:"$gen_producer", {self(), ref}, {:ask, @least}})
    %{state | sub: %{pid: pid, ref: ref, asked: @least, window: @least}}
  end

  defp window([%{data: data} | _]),
    do: div(@bytes, max(:erlang.external_size(data), 1)) |> max(@least) |> min(@most)

  defp leave(%{sub: nil} = state), do: state

  defp leave(%{sub: sub} = state) do
    Process.demonitor(sub.ref, [:flush])
    send(sub.pid, {:"$gen_producer", {self(), sub.ref}, {:cancel, :normal}})
    %{state | sub: nil}
  end
end
