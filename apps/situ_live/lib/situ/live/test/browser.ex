defmodule Situ.Live.Test.Browser do
  @moduledoc false
  # Plays the role of the connection: receives the view's messages, keeps the page, and acknowledges diffs.
  use GenServer
  alias Situ.JSON
  alias Situ.Live.ViewServer
  alias Situ.Live.Test.DiffTree

  defstruct [
              :view,
              :topic,
              :join_result,
              tree: %{},
              rows: %{},
              events: [],
              visits: [],
              title: nil
            ] ++
              [ref: 1, callers: %{}, exit_reason: nil]

  def start_link(join), do: GenServer.start_link(__MODULE__, join)

  @impl true
  def init(join) do
    {:ok, view} = GenServer.start(ViewServer, Map.put(join, :transport, self()))
    Process.monitor(view)
    {:ok, %__MODULE__{view: view, topic: join.topic}}
  end

  @impl true
  def handle_call(:joined, from, %{join_result: nil} = state),
    do: {:noreply, %{state | callers: Map.put(state.callers, "join", from)}}

  def handle_call(:joined, _from, state), do: {:reply, state.join_result, state}

  def handle_call({:push, event, payload}, from, state) do
    ref = Integer.to_string(state.ref)
    send(state.view, {:situ_live, ref, event, payload})
    {:noreply, %{state | ref: state.ref + 1, callers: Map.put(state.callers, ref, from)}}
  end

  def handle_call(:html, _from, state),
    do: {:reply, DiffTree.to_html(state.tree, state.rows), state}

  def handle_call(:view, _from, state), do: {:reply, {state.view, state.exit_reason}, state}
  def handle_call(:title, _from, state), do: {:reply, state.title, state}
  def handle_call(:visits, _from, state), do: {:reply, Enum.reverse(state.visits), state}

  def handle_call({:events, name}, _from, state) do
    {matching, others} = Enum.split_with(Enum.reverse(state.events), &match?([^name | _], &1))

    {:reply, Enum.map(matching, fn [_, payload | _] -> payload end),
     %{state | events: Enum.reverse(others)}}
  end

  @impl true
  def handle_info({:situ_live, _topic, _ref, text}, state) do
    {:ok, [_join_ref, ref, _, event, payload]} = JSON.decode(text)
    {:noreply, handle_message(event, ref, payload, state)}
  end

  def handle_info({:DOWN, _, _, _, reason}, state) do
    for {_, from} <- state.callers, do: GenServer.reply(from, {:error, {:view_down, reason}})

    {:noreply,
     %{
       state
       | exit_reason: reason,
         callers: %{},
         join_result: state.join_result || {:error, {:view_down, reason}}
     }}
  end

  defp handle_message("phx_reply", "join", %{"status" => status, "response" => response}, state) do
    result = if status == "ok", do: :ok, else: {:error, response}
    state = state |> apply_diff(response["rendered"] || %{}) |> Map.put(:join_result, result)
    reply_to_waiting(state, "join", result)
  end

  defp handle_message("phx_reply", ref, %{"status" => status, "response" => response}, state) do
    diff = response["diff"] || %{}
    state = apply_diff(state, diff)
    reply_to_waiting(state, ref, {:"#{status}", diff["r"] || Map.delete(response, "diff")})
  end

  defp handle_message("diff", _, diff, state), do: apply_diff(state, diff)

  defp handle_message(kind, _, %{"to" => to}, state),
    do: %{state | visits: [{String.to_existing_atom(kind), to} | state.visits]}

  defp reply_to_waiting(state, ref, result) do
    {from, callers} = Map.pop(state.callers, ref)
    if from, do: GenServer.reply(from, result)
    %{state | callers: callers}
  end

  defp apply_diff(state, diff) when diff == %{}, do: state

  defp apply_diff(state, diff) do
    {acks, events} = diff |> Map.get("e", []) |> Enum.split_with(&match?(["situ:ack" | _], &1))
    payload = %{"event" => "situ:ack", "type" => "hook", "value" => %{}}
    for _ <- acks, do: send(state.view, {:situ_live, "ack", "event", payload})
    tree = DiffTree.merge_diff(state.tree, diff)
    rows = Enum.reduce(DiffTree.stream_updates(tree), state.rows, &apply_stream/2)

    %{
      state
      | tree: DiffTree.clear_streams(tree),
        rows: rows,
        events: Enum.reverse(events) ++ state.events,
        title: diff["t"] || state.title
    }
  end

  # Only the page keeps the rows of a stream.
  defp apply_stream({[ref, inserts, deletes | reset], htmls}, rows) do
    list = if reset == [true], do: [], else: Map.get(rows, ref, [])
    list = Enum.reject(list, fn {id, _} -> id in deletes end)

    list =
      inserts
      |> Enum.zip(htmls)
      |> Enum.reduce(list, fn {[id, at, limit, _], html}, list ->
        insert_row(list, {id, html}, at, limit)
      end)

    Map.put(rows, ref, list)
  end

  defp insert_row(rows, {id, _} = row, at, limit) do
    rows =
      if List.keymember?(rows, id, 0),
        do: List.keyreplace(rows, id, 0, row),
        else: List.insert_at(rows, at, row)

    case limit do
      nil -> rows
      n -> Enum.take(rows, n)
    end
  end
end
