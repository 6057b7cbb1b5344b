defmodule Situ.Annotation.SegmentingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Layer, Schema, Segmenting}

  defp run(items, build) do
    replay = [replay: [interval: {0, :unbounded}, speed: :max]]

    Situ.to_list(fn p -> p |> Situ.from_enumerable(items) |> build.() end,
      times: true,
      pipeline: replay
    )
  end

  defp spans(out), do: for({_, set} <- out, a <- set, do: {a.track, a.from, a.to})

  test "annotates booleans while they are true, up to the next false message" do
    items = [{1, false}, {2, true}, {3, true}, {5, false}, {7, true}, {8, true}]

    out =
      run(
        items,
        &Segmenting.from_booleans(&1,
          track: "P1",
          values: %{"S" => "speaks"},
          proposed: true,
          by: "vad"
        )
      )

    assert spans(out) == [{"P1", 2, 5}, {"P1", 7, 8}]
    assert [{5, [%{values: %{"S" => "speaks"}, proposed?: true, by: "vad"}]}, {8, _}] = out
  end

  test "annotates each key on its own track, and splits at changed values" do
    items = [
      {1, %{"A" => "x"}},
      {2, %{"A" => "x", b: "x"}},
      {3, %{"A" => "y", b: "x"}},
      {4, %{"A" => "y"}}
    ]

    out = run(items, &Segmenting.from_keys(&1, fn _, v -> %{"V" => v} end))
    assert spans(out) == [{"A", 1, 3}, {"b", 2, 4}, {"A", 3, 5}]
    assert Enum.map(out, &elem(&1, 0)) == [3, 4, 5]
  end

  property "ends annotations at messages, and a layer accepts them all" do
    forall flags <- list({boolean(), boolean()}) do
      items = for {{a, b}, i} <- Enum.with_index(flags, 1), do: {i * 10, %{"A" => a, "B" => b}}
      out = run(items, &Segmenting.from_keys(&1, fn _, on? -> on? && %{"V" => "on"} end))

      for {time, set} <- out,
          a <- set,
          do: assert(a.to == time and Annotation.check_fields(a) == :ok)

      all = for {_, set} <- out, a <- set, do: a
      assert {:ok, layer} = Layer.new(Schema.text("V"), all)

      # Each message is covered exactly while it is true. An end belongs to the next segment.
      for {time, map} <- items, {track, on?} <- map, time != length(flags) * 10 do
        covered = Enum.any?(Layer.on_track(layer, track), &(&1.from <= time and time < &1.to))
        assert covered == on?
      end

      true
    end
  end
end
