defmodule Situ.Store.SinkTest do
  # A sink writes the messages that arrive, and keeps those written before an error.
  use ExUnit.Case, async: true
  alias Situ.{Message, Pipeline, Store}

  @moduletag :tmp_dir

  test "a failing pipeline leaves an intact, closed store", %{tmp_dir: root} do
    {:error, _} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "failing", root)

        p
        |> Situ.from_enumerable(for(i <- 1..100, do: {i * 1_000, i}))
        |> Store.write(exporter, "in")
        |> Situ.map(fn n -> if n == 60, do: raise("no"), else: n end)
        |> Store.write(exporter, "out")
      end)

    store = Store.open!(Path.join(root, "failing"))
    assert %{closed?: true, damage: []} = Store.info(store)
    out = store |> Store.messages("out") |> Enum.map(& &1.data)
    assert out == Enum.take(1..100, length(out))
  end

  test "a message that cannot be stored stops the pipeline and names the stream", %{tmp_dir: root} do
    {:error, error} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, "bad", root)

        p
        |> Situ.from_enumerable([{1, 1}, {2, self()}])
        |> Store.write(exporter, "pids")
      end)

    assert Exception.message(error) =~ "process id"
  end

  test "numbers, other data and large binaries of one stream stay in order", %{tmp_dir: root} do
    large = String.duplicate("x", 100_000)
    data = Enum.to_list(1..5_000) ++ [0.5, nil, %{a: 1}, "short", large, {:b, 2}] ++ [7, 8]
    :ok = record(root, "mixed", %{"s" => data})
    assert recorded(root, "mixed", "s") == data
  end

  test "one commit writes many streams, and each is complete", %{tmp_dir: root} do
    streams =
      for k <- 1..60, into: %{} do
        data = for i <- 1..(k * 20), do: if(rem(k, 2) == 0, do: i * k, else: "#{i} of #{k}")
        {"s#{k}", data}
      end

    :ok = record(root, "wide", streams)
    for {name, data} <- streams, do: assert(recorded(root, "wide", name) == data)
  end

  test "a restarted writer skips what its predecessor had committed", %{tmp_dir: root} do
    {:ok, writer} = Store.Writer.create("restarted", root)
    {:ok, stream} = Store.Writer.stream(writer, "s")
    {:ok, _} = Store.Writer.append(stream, messages(1..7))
    {:ok, state} = Store.Sink.init(stream: stream, eager: true, pass: true)

    # They come again in several deliveries, one of which also has new messages.
    for range <- [1..3, 4..5, 6..9, 10..11], reduce: state do
      state ->
        messages = messages(range)

        assert {[{:out, ^messages}], state} =
                 Store.Sink.handle_messages(:in, messages, %{}, state)

        state
    end

    :ok = Store.Writer.close(writer)
    assert recorded(root, "restarted", "s") == Enum.to_list(1..11)
  end

  for {kind, large} <- [numbers: "", mixed: String.duplicate("x", 5_000)] do
    test "#{kind}: a sink continues from its checkpoint in a copy of the recording", %{
      tmp_dir: root
    } do
      large = unquote(large)
      fill = fn m -> if large == "", do: m, else: %{m | data: {m.data, large}} end
      sent = 1..60 |> messages() |> Enum.map(fill)
      {:ok, state, _writer} = open_sink(root, "first")
      state = deliver(state, Enum.take(sent, 40))
      {:ok, snapshot} = Store.Sink.snapshot(state)

      # The part is lost without being closed, and has written more after its checkpoint.
      Store.Sink.terminate(:normal, deliver(state, Enum.slice(sent, 40, 10)))

      {:ok, fresh, writer} = open_sink(root, "second")
      {:ok, state} = snapshot |> transfer_term() |> Store.Sink.restore(fresh)
      {:ok, again} = Store.Sink.snapshot(state)
      assert again.span == {1, 40}
      state = deliver(state, Enum.drop(sent, 40))
      {[], _} = Store.Sink.handle_closed(:in, 61, %{}, state)
      :ok = Store.Writer.close(writer)

      stored = root |> Path.join("second") |> Store.open!() |> Store.messages("s")
      key = &{&1.data, &1.originating_time, &1.sequence_id}
      assert Enum.map(stored, key) == Enum.map(sent, key)
    end
  end

  test "a sink that cannot read the previous recording says which messages are missing", %{
    tmp_dir: root
  } do
    {:ok, state, writer} = open_sink(root, "lost")
    {:ok, snapshot} = Store.Sink.snapshot(deliver(state, messages(1..5)))
    :ok = Store.Writer.close(writer)
    :ok = Store.delete(Path.join(root, "lost"))
    {:ok, fresh, writer} = open_sink(root, "rest")

    log =
      ExUnit.CaptureLog.capture_log(fn ->
        {:ok, state} = Store.Sink.restore(snapshot, fresh)
        {[], _} = Store.Sink.handle_closed(:in, 9, %{}, deliver(state, messages(6..9)))
      end)

    :ok = Store.Writer.close(writer)
    assert log =~ "continues without the messages from 1 to 5 ns"
    assert log =~ Path.join(root, "lost")
    assert recorded(root, "rest", "s") == [6, 7, 8, 9]
  end

  defp open_sink(root, name) do
    {:ok, writer} = Store.Writer.create(name, root)
    {:ok, stream} = Store.Writer.stream(writer, "s")
    shared = Store.SharedWriter.new(writer)
    Store.SharedWriter.add_user(shared)
    {:ok, state} = Store.Sink.init(shared: shared, stream: stream, envelopes: false, eager: false)
    {:ok, state, writer}
  end

  defp deliver(state, messages) do
    {[], state} = Store.Sink.handle_messages(:in, messages, %{}, state)
    state
  end

  defp transfer_term(term), do: term |> :erlang.term_to_binary() |> :erlang.binary_to_term()

  defp messages(numbers),
    do: for(n <- numbers, do: %Message{data: n, originating_time: n, sequence_id: n})

  test "messages are committed while their pipeline waits for more", %{tmp_dir: root} do
    {:ok, p} =
      Pipeline.start_link(fn p ->
        exporter = Store.create(p, "live", root)

        for name <- ["a", "b"],
            do: p |> Situ.timer(every: Situ.Time.s(2)) |> Store.write(exporter, name)
      end)

    store = Store.open!(Path.join(root, "live"))
    for name <- ["a", "b"], do: assert([_ | _] = await_messages(store, name, 0))
    assert Store.info(store).live?
    assert {:ok, _report} = Pipeline.stop(p)
  end

  defp await_messages(store, name, known) do
    case Enum.to_list(Store.messages(store, name)) do
      [] ->
        Store.notify(store, known)
        assert_receive {:situ_store, 0, {:published, n}}, 10_000
        await_messages(store, name, n)

      messages ->
        messages
    end
  end

  defp record(root, name, streams) do
    {:ok, _} =
      Pipeline.run(fn p ->
        exporter = Store.create(p, name, root)

        for {stream, data} <- streams do
          rows = for {value, i} <- Enum.with_index(data, 1), do: {i * 1_000, value}
          p |> Situ.from_enumerable(rows) |> Store.write(exporter, stream)
        end
      end)

    :ok
  end

  defp recorded(root, name, stream) do
    root |> Path.join(name) |> Store.open!() |> Store.messages(stream) |> Enum.map(& &1.data)
  end
end
