defmodule Situ.Studio.Annotations.ProposalsTest do
  use ExUnit.Case, async: true

  alias Situ.Message
  alias Situ.Studio.Annotations.Proposals
  alias Situ.Studio.{History, Recordings}

  # Returns a source in memory with messages at these times.
  defp source(rows) do
    history = History.new(live: false, seconds: 1_000_000, megabytes: 400)

    for {{t, data}, n} <- Enum.with_index(rows, 1) do
      message = %Message{data: data, originating_time: t, creation_time: t, sequence_id: n}
      :ok = History.put(history, "S", message, 8)
    end

    Recordings.History.wrap(history)
  end

  defp spans({:ok, found}), do: for(p <- found, do: {p.lane, p.from, p.to, p.label})

  test "reads every message, page by page" do
    # Only message 77,777 of 120,000 is true, so a sample would miss it.
    rows = for i <- 0..119_999, do: {i * 10, i == 77_777}

    assert rows |> source() |> Proposals.collect_proposals("S", :boolean) |> spans() == [
             {"", 777_770, 777_780, ""}
           ]

    rows = for i <- 0..119_999, do: {i * 10, i in 40_000..60_000}

    assert rows |> source() |> Proposals.collect_proposals("S", :boolean) |> spans() == [
             {"", 400_000, 600_010, ""}
           ]
  end

  test "ends a segment at a gap, and otherwise at the end of the stream" do
    rows = for i <- Enum.concat(0..99, 500..599), do: {i * 10, true}

    assert rows |> source() |> Proposals.collect_proposals("S", :boolean) |> spans() ==
             [{"", 0, 1_000, ""}, {"", 5_000, 5_990, ""}]
  end

  test "finds numbers at or above a threshold, with their mean as confidence" do
    rows = [{0, 0.2}, {10, 0.6}, {20, 0.8}, {30, 0.1}, {40, 1.5}]
    {:ok, found} = rows |> source() |> Proposals.collect_proposals("S", :signal, 0.5)

    assert for(p <- found, do: {p.from, p.to, Float.round(p.confidence, 3)}) ==
             [{10, 30, 0.7}, {40, 40, 1.0}]

    maps = for {t, x} <- rows, do: {t, %{"a" => x, "b" => 1 - x}}
    {:ok, found} = maps |> source() |> Proposals.collect_proposals("S", :signals, 0.7)

    assert for(p <- found, do: {p.lane, p.from, p.to}) == [
             {"a", 20, 30},
             {"a", 40, 40},
             {"b", 0, 10},
             {"b", 30, 40}
           ]
  end

  test "finds states by value, and the final version of a recognizer's drafts" do
    rows = [{0, :idle}, {10, :moving}, {20, :moving}, {30, nil}, {40, :idle}]

    assert rows |> source() |> Proposals.collect_proposals("S", :state) |> spans() ==
             [{"", 0, 10, "idle"}, {"", 10, 30, "moving"}, {"", 40, 40, "idle"}]

    said = &%{text: &1, from: 5, to: &2, final?: &3, confidence: 0.75}

    rows = [
      {10, said.("ten", 9, false)},
      {20, said.("ten of", 19, false)},
      {30, said.("ten of clubs", 28, true)}
    ]

    assert {:ok, [%{from: 5, to: 28, label: "ten of clubs", confidence: 0.75}]} =
             rows |> source() |> Proposals.collect_proposals("S", :spans)
  end

  test "rejects images, and too many segments" do
    assert {:error, %{code: :no_segments}} =
             [{0, 1}] |> source() |> Proposals.collect_proposals("S", :image)

    rows = for i <- 0..50_000, do: {i * 10, rem(i, 2) == 0}

    assert {:error, %{code: :too_many}} =
             rows |> source() |> Proposals.collect_proposals("S", :boolean)
  end
end
