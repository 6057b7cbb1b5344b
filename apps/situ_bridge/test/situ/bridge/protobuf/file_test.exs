defmodule Situ.Bridge.Protobuf.FileTest do
  # Not async, because other tests would add to the counted atoms.
  use ExUnit.Case, async: false
  alias Situ.Bridge.Protobuf
  alias Situ.Test.Budget
  alias Situ.Pipeline

  @moduletag :tmp_dir
  @lab """
  syntax = "proto3"; package lab;
  import "google/protobuf/timestamp.proto";
  message Header { google.protobuf.Timestamp stamp = 1; string who = 2; }
  message Level { Header header = 1; double volts = 2; repeated sint32 raw = 3; }
  message Bare { double volts = 1; }
  """
  @start 1_700_000_000_000_000_000

  defp written(path, values, opts) do
    {:ok, _} =
      Pipeline.run(
        fn p -> p |> Situ.from_enumerable(values) |> Protobuf.File.write(path, opts) end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )
  end

  defp levels do
    for i <- 0..999,
        do:
          {@start + i * 1_000,
           %{"header" => %{"who" => "me"}, "volts" => i / 4, "raw" => [i, -i]}}
  end

  test "reads written messages with the definition next to the file, to the nanosecond", %{
    tmp_dir: dir
  } do
    path = Path.join(dir, "levels.pb")
    written(path, levels(), type: "lab.Level", definition: @lab)
    read = path |> Protobuf.File.messages(type: "lab.Level") |> Enum.to_list()
    assert Enum.map(read, &elem(&1, 0)) == Enum.map(levels(), &elem(&1, 0))
    {time, last} = List.last(read)
    assert %{"volts" => 249.75, "raw" => [999, -999], "header" => %{"stamp" => ^time}} = last
    source = &Protobuf.File.read(&1, path, type: "lab.Level", definition: @lab)
    assert Situ.to_list(source, times: true) == read
  end

  test "maps Foxglove's messages to Situ's types", %{tmp_dir: dir} do
    path = Path.join(dir, "poses.pb")

    poses =
      for i <- 1..5,
          do: {@start + i, Situ.Transform.new("a", "b", Situ.Pose.new({i / 1, 0.0, 0.0}))}

    written(path, poses, type: "foxglove.FrameTransform")

    assert path |> Protobuf.File.messages(type: "foxglove.FrameTransform") |> Enum.to_list() ==
             poses
  end

  test "spaces messages without a time by every:, or rejects them", %{tmp_dir: dir} do
    path = Path.join(dir, "bare.pb")
    {:ok, schema} = Protobuf.parse_schema(@lab)
    {:ok, bytes} = Protobuf.encode(schema, "lab.Bare", %{"volts" => 1.5})
    File.write!(path, for(_ <- 1..3, do: [byte_size(bytes), bytes]))
    opts = [type: "lab.Bare", definition: @lab]
    read = Protobuf.File.messages(path, [every: 10, start: 5] ++ opts)
    assert Enum.to_list(read) == for(t <- [5, 15, 25], do: {t, %{"volts" => 1.5}})
    assert_raise Situ.Error, ~r/every:/, fn -> Protobuf.File.messages(path, opts) end

    assert_raise Situ.Error, ~r/volts is no/, fn ->
      Protobuf.File.messages(path, [time: "volts"] ++ opts)
    end

    assert_raise Situ.Error, ~r/lab.Nothing/, fn ->
      Protobuf.File.messages(path, type: "lab.Nothing", definition: @lab)
    end
  end

  test "reads a truncated file up to the fault, and reports it there", %{
    tmp_dir: dir
  } do
    path = Path.join(dir, "levels.pb")
    written(path, levels(), type: "lab.Level", definition: @lab)
    whole = File.read!(path)
    File.write!(path, binary_part(whole, 0, byte_size(whole) - 1))
    read = Protobuf.File.messages(path, type: "lab.Level")
    assert read |> Enum.take(999) |> length() == 999
    assert_raise Situ.Error, ~r/ends within a message/, fn -> Enum.count(read) end
    File.write!(path, [whole, :binary.copy(<<255>>, 20)])
    assert read |> Enum.take(1_000) |> length() == 1_000
    assert_raise Situ.Error, ~r/length of a message is invalid/, fn -> Enum.count(read) end
    File.write!(path, "")
    assert Enum.to_list(read) == []

    assert {:error, %{code: :not_writable}} =
             Pipeline.run(fn p ->
               p
               |> Situ.from_enumerable([{0, %{"volts" => "much"}}])
               |> Protobuf.File.write(path, type: "lab.Level", definition: @lab)
             end)
  end

  test "reads mutated files as messages or errors", %{tmp_dir: dir} do
    path = Path.join(dir, "levels.pb")
    written(path, Enum.take(levels(), 20), type: "lab.Level", definition: @lab)
    whole = File.read!(path)
    read = Protobuf.File.messages(path, type: "lab.Level")
    atoms = :erlang.system_info(:atom_count)

    for _ <- 1..Budget.mutation_count(500) do
      at = :rand.uniform(byte_size(whole)) - 1
      <<before::binary-size(at), _, rest::binary>> = whole
      File.write!(path, [before, Enum.random([<<255>>, <<0>>, <<:rand.uniform(255)>>, ""]), rest])

      try do
        for {time, %{}} <- read, do: assert(is_integer(time))
      rescue
        error in Situ.Error -> assert error.code == :bad_file
      end
    end

    assert :erlang.system_info(:atom_count) - atoms < 500
  end
end
