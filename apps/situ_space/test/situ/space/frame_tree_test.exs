defmodule Situ.Space.FrameTreeTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Pose, Quaternion, Vector3}
  alias Situ.Space.FrameTree
  doctest FrameTree

  defp coordinate, do: map(integer(-500, 500), &(&1 / 100))

  defp pose do
    map({coordinate(), coordinate(), coordinate(), coordinate()}, fn {x, y, z, yaw} ->
      Pose.new({x, y, z}, Quaternion.from_euler(yaw, 0, 0))
    end)
  end

  defp ok({:ok, value}), do: value

  property "there and back is the identity along any path" do
    forall {a, b, c, point} <-
             {pose(), pose(), pose(), {coordinate(), coordinate(), coordinate()}} do
      frames =
        FrameTree.new()
        |> FrameTree.put_static("a", "world", a)
        |> ok()
        |> FrameTree.put_static("b", "a", b)
        |> ok()
        |> FrameTree.put_moving("c", "world", 5, c)
        |> ok()

      there = ok(FrameTree.lookup(frames, "b", "c", 5))
      back = ok(FrameTree.lookup(frames, "c", "b", 5))

      assert Vector3.distance(
               point,
               Pose.transform_point(back, Pose.transform_point(there, point))
             ) < 1.0e-6

      world = Pose.transform_point(Pose.compose(a, b), point)

      assert Vector3.distance(
               Pose.transform_point(ok(FrameTree.lookup(frames, "b", "world", 0)), point),
               world
             ) < 1.0e-6
    end
  end

  property "lookups match a list of all poses that were put, in any order" do
    forall {times, asked} <- {list(integer(0, 50)), integer(-5, 55)} do
      poses = times |> Enum.uniq() |> Enum.map(&{&1, Pose.new({&1 * &1 * 1.0, 0.0, 0.0})})

      frames =
        Enum.reduce(poses, FrameTree.new(keep: 1_000), fn {t, p}, f ->
          ok(FrameTree.put_moving(f, "m", "w", t, p))
        end)

      before =
        poses |> Enum.filter(&(elem(&1, 0) <= asked)) |> Enum.max_by(&elem(&1, 0), fn -> nil end)

      later =
        poses |> Enum.filter(&(elem(&1, 0) >= asked)) |> Enum.min_by(&elem(&1, 0), fn -> nil end)

      case {before, later, FrameTree.lookup(frames, "m", "w", asked)} do
        {{t, pose}, {t, _}, result} ->
          assert result == {:ok, pose}

        {{s, a}, {t, b}, {:ok, pose}} ->
          assert pose == Pose.interpolate(a, b, (asked - s) / (t - s))

        {_, _, {:error, error}} ->
          assert (before == nil or later == nil) and error.code != nil
      end
    end
  end

  test "keeps only the last time span, and one pose before it" do
    frames =
      Enum.reduce(
        0..100,
        FrameTree.new(keep: 10),
        &ok(FrameTree.put_moving(&2, "m", "w", &1, Pose.identity()))
      )

    assert {:ok, _} = FrameTree.lookup(frames, "m", "w", 90)
    assert {:error, %{code: :frame_unknown_at}} = FrameTree.lookup(frames, "m", "w", 89)
  end

  test "errors about cycles, second parents and missing connections name the frames" do
    frames = ok(FrameTree.put_static(FrameTree.new(), "b", "a", Pose.identity()))
    frames = ok(FrameTree.put_static(frames, "c", "b", Pose.identity()))

    assert {:error, %{code: :frame_cycle, what: what}} =
             FrameTree.put_static(frames, "a", "c", Pose.identity())

    assert what == ~s(the frames would form a cycle: "a" in "c" in "b" in "a")

    assert {:error, %{code: :frame_cycle}} =
             FrameTree.put_static(frames, "a", "a", Pose.identity())

    assert {:error, %{code: :frame_conflict}} =
             FrameTree.put_static(frames, "c", "a", Pose.identity())

    assert {:error, %{code: :frame_conflict}} =
             FrameTree.put_moving(frames, "c", "b", 0, Pose.identity())

    assert {:error, %{code: :frame_not_connected, why: why}} =
             FrameTree.lookup(frames, "c", "elsewhere", 0)

    assert why == ~s(the root of the first is "a", the root of the second "elsewhere")

    assert {:error, %{code: :frame_not_connected}} =
             frames |> FrameTree.delete("b") |> FrameTree.lookup("c", "a", 0)

    assert FrameTree.list(frames) == [{"b", "a", :static}, {"c", "b", :static}]
  end
end
