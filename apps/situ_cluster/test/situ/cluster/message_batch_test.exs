defmodule Situ.Cluster.MessageBatchTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.{MessageBatch, StreamEntry, SignedEntry}
  alias Situ.Message

  defp messages(first, sizes) do
    for {size, i} <- Enum.with_index(sizes) do
      %Message{
        data: :binary.copy("x", size),
        originating_time: 10 * i,
        creation_time: 10 * i + 1,
        sequence_id: first + i,
        source_id: 0
      }
    end
  end

  property "packed messages survive being cut and written to the log" do
    forall {first, sizes, cut} <-
             {integer(1, 100), list(integer(0, 3_000)), integer(0, 120)} do
      all = messages(first, [5 | sizes])
      batch = MessageBatch.pack_messages(all)
      behind = MessageBatch.take_after(batch, cut)
      kept = if behind, do: MessageBatch.to_messages(behind), else: []
      mark = %{last: batch.last, time: batch.time, made: batch.made, closing: nil}
      entry = batch |> parts() |> StreamEntry.build_data(mark, 1, "op") |> through_log()

      MessageBatch.to_messages(batch) == all and MessageBatch.count_messages(batch) == length(all) and
        kept == Enum.filter(all, &(&1.sequence_id > cut)) and
        StreamEntry.decode_messages(entry) == {:ok, all} and StreamEntry.entry_mark(entry) == mark
    end
  end

  defp through_log(entry) do
    sealed = %{SignedEntry.seal_entry(entry, "run", {:stream, "s"}, 6) | seq: 7}
    {:ok, entry} = SignedEntry.verify_entry(sealed, "run", {:stream, "s"})
    entry
  end

  defp parts(%{first: id, last: id} = batch), do: [batch]
  defp parts(batch), do: batch |> MessageBatch.split_in_half() |> Tuple.to_list()

  test "small data becomes bytes, and large data is not copied" do
    assert is_binary(MessageBatch.pack_messages(messages(1, [10, 10])).body)
    [%{data: picture}] = all = messages(1, [100_000])
    assert %{body: [{0, 1, ^picture}], bytes: bytes} = MessageBatch.pack_messages(all)
    assert bytes > 100_000
  end
end
