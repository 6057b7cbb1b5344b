defmodule Situ.Cluster.OutgoingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.Outgoing
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

  # Batches of increasing times, some of them a second time, as a part that starts again gives them.
  property "what was there is passed over; the rest is numbered without gaps" do
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
        {fresh, out} = Outgoing.add(out, messages(from..(from + n - 1)))
        {fresh, {out, from + n}}
      end)

    {Enum.concat(lists), out}
  end

  test "creation times do not go back, whatever this machine's clock says" do
    {_, out} = Outgoing.add(Outgoing.new("s", "d"), [%{hd(messages([1])) | creation_time: 900}])
    {[second], _} = Outgoing.add(out, [%{hd(messages([2])) | creation_time: 100}])
    assert second.creation_time == 900
  end

  test "what is not stored yet is never trimmed" do
    {fresh, out} = Outgoing.add(Outgoing.new("s", "d"), messages(1..30_000))
    out = fresh |> Enum.chunk_every(500) |> Enum.reduce(out, &Outgoing.show(&2, &1))
    assert {:ok, [%{data: 1} | _]} = Outgoing.recall(out, 1)
    {fresh, out} = Outgoing.add(%{out | stored: out.mark}, messages(30_001..31_000))
    out = Outgoing.show(out, fresh)
    assert :gone = Outgoing.recall(out, 1)
    assert {:ok, [%{data: 30_900} | _]} = Outgoing.recall(out, 30_900)
  end

  test "pictures fill it sooner than numbers" do
    big = for m <- messages(1..10), do: %{m | data: :binary.copy("x", 1_000_000)}
    {_, out} = Outgoing.add(Outgoing.new("s", "d"), big)
    assert Outgoing.full?(out)
    {_, out} = Outgoing.add(Outgoing.new("s", "d"), messages(1..10))
    refute Outgoing.full?(out)
  end
end
