defmodule Situ.Cluster.OutgoingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.{Batch, Outgoing}
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
      {fresh, out} = feed(Outgoing.new("s", "d"), sizes, 1)
      {again, out} = feed(out, sizes, max(1, total - back))
      all = fresh ++ again

      Enum.map(all, & &1.sequence_id) == Enum.to_list(1..length(all)//1) and
        Enum.map(all, & &1.data) == Enum.to_list(1..out.mark.last//1)
    end
  end

  defp feed(out, sizes, from) do
    {lists, {out, _}} =
      Enum.map_reduce(sizes, {out, from}, fn n, {out, from} ->
        {batch, out} = Outgoing.add_messages(out, messages(from..(from + n - 1)))
        {if(batch, do: Batch.to_messages(batch), else: []), {out, from + n}}
      end)

    {Enum.concat(lists), out}
  end

  test "creation times do not go back, whatever this machine's clock says" do
    {_, out} =
      Outgoing.add_messages(Outgoing.new("s", "d"), [%{hd(messages([1])) | creation_time: 900}])

    {second, _} = Outgoing.add_messages(out, [%{hd(messages([2])) | creation_time: 100}])
    assert [%{creation_time: 900}] = Batch.to_messages(second)
  end

  test "never trims messages that are not stored yet" do
    out = 1..60_000 |> Enum.chunk_every(500) |> Enum.reduce(Outgoing.new("s", "d"), &shown/2)
    assert {:ok, %{first: 1, last: 500}} = Outgoing.fetch_batch(out, 1)
    out = shown(60_001..61_000, Outgoing.note_stored(out, out.mark, 1))
    assert :gone = Outgoing.fetch_batch(out, 1)
    assert {:ok, %{first: 60_001, last: 61_000}} = Outgoing.fetch_batch(out, 60_900)
  end

  defp shown(times, out) do
    case Outgoing.add_messages(out, messages(times)) do
      {nil, out} -> out
      {batch, out} -> Outgoing.make_visible(out, batch)
    end
  end

  test "images fill it sooner than numbers" do
    big = for m <- messages(1..10), do: %{m | data: :binary.copy("x", 1_000_000)}
    {_, out} = Outgoing.add_messages(Outgoing.new("s", "d"), big)
    assert Outgoing.full?(out)
    {_, out} = Outgoing.add_messages(Outgoing.new("s", "d"), messages(1..10))
    refute Outgoing.full?(out)
  end

  test "keeps only the end of a direct stream for the log" do
    out = Outgoing.new("s", "d", %{direct: true, policies: %{}})
    {%Batch{first: 1, last: 3}, out} = Outgoing.add_messages(out, messages([10, 20, 30]))
    refute Outgoing.pending?(out)
    out = Outgoing.close(out, 40)
    assert Outgoing.pending?(out)
    assert {{[], %{last: 3, closing: 40}}, out} = Outgoing.take_pending(out)
    refute Outgoing.pending?(out)
  end
end
