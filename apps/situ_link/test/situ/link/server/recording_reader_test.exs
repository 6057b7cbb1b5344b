defmodule Situ.Link.Server.RecordingReaderTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  import Situ.Test.LinkRecordings
  alias Situ.Delivery
  alias Situ.Link.Wire.Batch
  alias Situ.Link.Server.RecordingReader
  alias Situ.Store.Writer

  setup do
    {:ok, root: folder()}
  end

  defp times(state, cursor, done \\ []) do
    case RecordingReader.read(state, cursor) do
      {:parts, parts, cursor} ->
        found =
          for {_, _, _, payload} <- parts,
              {:ok, messages} = Batch.decode(IO.iodata_to_binary(payload)),
              message <- messages,
              do: message.originating_time

        times(state, cursor, done ++ found)

      other ->
        {done, other}
    end
  end

  test "versions are read as one recording from any time, whichever has the stream", %{
    root: root
  } do
    finish(begin(root, "r", %{"n" => messages(1..5)}), 5)
    finish(begin(root, "r", %{"other" => messages(6..7)}), 7)
    {:ok, killed} = Writer.create("r", root)
    {:ok, stream} = Writer.stream(killed, "n")
    {:ok, _} = Writer.append(stream, messages(8..9))
    finish(begin(root, "r", %{"n" => messages(9..12)}), 20)

    {:ok, state} = RecordingReader.open({:series, root, "r"})

    for from <- 0..13 do
      {:ok, cursor, before} = RecordingReader.open_cursor(state, "n", {:at, from})
      assert before == from - 1
      expected = Enum.filter([1, 2, 3, 4, 5, 8, 9, 10, 11, 12], &(&1 >= from))
      assert {^expected, {:ended, 20}} = times(state, cursor)
    end

    assert {:ok, _, 12} = RecordingReader.open_cursor(state, "n", :now)
    assert RecordingReader.open_cursor(state, "gone", :start) == :unknown
    {:ok, alone, _} = RecordingReader.open_cursor(state, "other", {:at, 0})
    assert {[6, 7], {:idle, _}} = times(state, alone)

    # The segments of live streams are one recording.
    {:ok, live} = RecordingReader.open({:live, root, "r"})
    {:ok, cursor, before} = RecordingReader.open_cursor(live, "n", :start)
    assert before == Situ.Link.Wire.Batch.before_all()
    assert {[1, 2, 3, 4, 5, 8, 9, 10, 11, 12], {:ended, 20}} = times(live, cursor)
    {:ok, newest, ^before} = RecordingReader.open_cursor(state, "n", :start)
    assert {[9, 10, 11, 12], {:ended, 20}} = times(state, newest)
  end

  test "a lossy policy keeps only its messages", %{root: root} do
    finish(begin(root, "r", %{"n" => messages(1..100)}), 100)
    {:ok, state} = RecordingReader.open({:series, root, "r"})
    {:ok, cursor, _} = RecordingReader.open_cursor(state, "n", :start)
    {skipped, latest} = RecordingReader.skip_messages(cursor, Delivery.latest(), 0)
    assert {99, {[100], _}} = {skipped, times(state, latest)}
    {90, few} = RecordingReader.skip_messages(cursor, Delivery.max_queue(10), 0)
    assert {found, _} = times(state, few)
    assert found == Enum.to_list(91..100)
    {69, young} = RecordingReader.skip_messages(cursor, Delivery.max_latency(50), 120)
    assert {[70 | _], _} = times(state, young)
    assert {0, ^cursor} = RecordingReader.skip_messages(cursor, Delivery.unlimited(), 0)
  end

  test "reports a commit and the end", %{root: root} do
    {writer, %{"n" => stream}} = begin(root, "r", %{"n" => messages(1..3)})
    {:ok, state} = RecordingReader.open({:series, root, "r"})
    {[%{name: "n"}], state} = RecordingReader.list_streams(state)
    assert {:same, state} = RecordingReader.list_streams(state)
    {:ok, cursor, 3} = RecordingReader.open_cursor(state, "n", :now)
    assert {:idle, cursor} = RecordingReader.read(state, cursor)
    state = RecordingReader.request_notice(state)
    assert_receive {:situ_store, 0, _} = news
    {:ok, state} = RecordingReader.handle_notice(state, news)
    assert RecordingReader.handle_notice(state, {:situ_store, 7, {:published, 99}}) == :other
    finish({writer, %{"n" => stream}}, 9)
    _state = RecordingReader.request_notice(state)
    assert_receive {:situ_store, 0, _}
    assert {:ended, 9} = RecordingReader.read(state, cursor)
  end
end
