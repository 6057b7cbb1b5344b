defmodule Situ.Cluster.SubscribersTest do
  use ExUnit.Case, async: true
  alias Situ.Cluster.{MessageBatch, OutgoingStream, Subscribers}
  alias Situ.Message

  defp out(times) do
    messages =
      for t <- times,
          do: %Message{data: t, originating_time: t, creation_time: t, sequence_id: t}

    out = "s" |> OutgoingStream.new("d", %{})
    {batch, out} = OutgoingStream.add_messages(out, messages)
    {OutgoingStream.make_visible(out, batch), batch}
  end

  # This process asks the readers for `n` messages.
  defp served(opts, n) do
    {out, batch} = out(1..5)
    readers = Subscribers.add_reader(%Subscribers{}, self(), :ref, out, [reader: "far"] ++ opts)
    {:ok, "s", readers} = Subscribers.add_demand(readers, :ref, n)
    {Subscribers.serve_stream(readers, out, nil), batch}
  end

  test "an inlet receives the shared packed bytes, not unpacked messages" do
    {readers, %MessageBatch{body: body}} = served([batches: true], 2)
    assert is_binary(body)
    assert_receive {:"$gen_consumer", {_, :ref}, {:situ_batch, 1, ^body}}
    # It received three more than it asked for, and gets nothing until it has made up for them.
    assert [%{last: 5, demand: -3}] = Subscribers.reader_positions(readers)
  end

  test "any other consumer receives as many messages as it asked for" do
    {readers, _} = served([], 2)
    assert_receive {:"$gen_consumer", {_, :ref}, [%{data: 1}, %{data: 2, sequence_id: 2}]}
    assert [%{last: 2, demand: 0}] = Subscribers.reader_positions(readers)
    refute_received {:"$gen_consumer", _, _}
  end
end
