defmodule Situ.Cluster.OutgoingStreamTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.{MessageBatch, OutgoingStream}
  alias Situ.Message

  defp messages(times) do
    for time <- times,
        do: %Message{
          data: time,
          originating_time: time,
          creation_time: 0,
          sequence_id: 1,
          source_id: 1
        }
  end

  # Batches with increasing times, some of them repeated, as after the restart of a part.
  property "skips known messages and numbers the rest without gaps" do
    forall {sizes, back} <- {list(integer(1, 20)), integer(0, 50)} do
      total = Enum.sum(sizes)
      {fresh, out} = feed(OutgoingStream.new("s", "d"), sizes, 1)
      {again, out} = feed(out, sizes, max(1, total - back))
      all = fresh ++ again

      Enum.map(all, & &1.sequence_id) == Enum.to_list(1..length(all)//1) and
        Enum.map(all, & &1.data) == Enum.to_list(1..out.mark.last//1)
    end
  end

  defp feed(out, sizes, from) do
    {lists, {out, _}} =
      Enum.map_reduce(sizes, {out, from}, fn n, {out, from} ->
        {batch, out} = OutgoingStream.add_messages(out, messages(from..(from + n - 1)))
        {if(batch, do: MessageBatch.to_messages(batch), else: []), {out, from + n}}
      end)

    {Enum.concat(lists), out}
  end

  test "creation times do not go back, whatever this machine's clock says" do
    {_, out} =
      OutgoingStream.add_messages(OutgoingStream.new("s", "d"), [
        %{hd(messages([1])) | creation_time: 900}
      ])

    {second, _} = OutgoingStream.add_messages(out, [%{hd(messages([2])) | creation_time: 100}])
    assert [%{creation_time: 900}] = MessageBatch.to_messages(second)
  end

  test "never trims messages that are not stored yet" do
    out =
      1..60_000 |> Enum.chunk_every(500) |> Enum.reduce(OutgoingStream.new("s", "d"), &shown/2)

    assert {:ok, %{first: 1, last: 500}} = OutgoingStream.fetch_batch(out, 1)
    out = shown(60_001..61_000, OutgoingStream.note_stored(out, out.mark, 1))
    assert :gone = OutgoingStream.fetch_batch(out, 1)
    assert {:ok, %{first: 60_001, last: 61_000}} = OutgoingStream.fetch_batch(out, 60_900)
  end

  defp shown(times, out) do
    case OutgoingStream.add_messages(out, messages(times)) do
      {nil, out} -> out
      {batch, out} -> OutgoingStream.make_visible(out, batch)
    end
  end

  test "images fill it sooner than numbers" do
    big = for m <- messages(1..10), do: %{m | data: :binary.copy("x", 1_000_000)}
    {_, out} = OutgoingStream.add_messages(OutgoingStream.new("s", "d"), big)
    assert OutgoingStream.full?(out)
    {_, out} = OutgoingStream.add_messages(OutgoingStream.new("s", "d"), messages(1..10))
    refute OutgoingStream.full?(out)
  end

  test "keeps only the end of a direct stream for the log" do
    out = OutgoingStream.new("s", "d", %{direct: true, policies: %{}})

    {%MessageBatch{first: 1, last: 3}, out} =
      OutgoingStream.add_messages(out, messages([10, 20, 30]))

    refute OutgoingStream.pending?(out)
    out = OutgoingStream.close(out, 40)
    assert OutgoingStream.pending?(out)
    assert {{[], %{last: 3, closing: 40}}, out} = OutgoingStream.take_pending(out)
    refute OutgoingStream.pending?(out)
  end
end
