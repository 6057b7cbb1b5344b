defmodule Situ.Bridge.HostileTest do
  # Reads mutated files and messages as recordings, values or errors, in bounded memory and
  # without new atoms.
  use ExUnit.Case, async: false
  alias Situ.Bridge.Foxglove.{Messages, StandardTypes}
  alias Situ.Bridge.{Mcap, Mqtt, Protobuf, WebSocket}
  alias Situ.Bridge.Ros.{Definition, Library, Wire}
  alias Situ.Test.Budget
  alias Situ.Store

  @moduletag :tmp_dir
  @moduletag :capture_log
  @moduletag timeout: Situ.Test.Budget.time_limit_ms()
  @data Path.expand("../../data", __DIR__)

  # Changes, cuts off, inserts or repeats some bytes.
  defp mutate(bytes, n) do
    :rand.seed(:exsss, {n, 17, 4})
    Enum.reduce(1..:rand.uniform(4), bytes, fn _, bytes -> change(bytes, :rand.uniform(5)) end)
  end

  defp change(bytes, kind) do
    at = :rand.uniform(byte_size(bytes) + 1) - 1
    <<head::binary-size(at), rest::binary>> = bytes

    case {kind, rest} do
      {1, <<_, rest::binary>>} ->
        head <> <<:rand.uniform(256) - 1>> <> rest

      {2, <<_::32, rest::binary>>} ->
        head <> Enum.random([<<255::32>>, <<-1::32>>, <<0::32>>, <<127, 255, 255, 255>>]) <> rest

      {3, _} ->
        head

      {4, _} ->
        head <> :crypto.strong_rand_bytes(:rand.uniform(8)) <> rest

      {5, _} ->
        head <> binary_part(rest, 0, min(byte_size(rest), 9)) <> rest

      _ ->
        bytes
    end
  end

  # Calls `fun` in a process with a bounded heap, and checks that few atoms and bytes are added.
  defp bounded(n, fun) do
    fun.(0)
    atoms = :erlang.system_info(:atom_count)
    memory = :erlang.memory(:total)

    task =
      Task.async(fn ->
        Process.flag(:max_heap_size, %{size: 20_000_000, kill: true, error_logger: true})
        for i <- 1..n, do: fun.(i)
        :done
      end)

    assert Task.await(task, :infinity) == :done
    # Lazily loaded modules add a few atoms.
    assert :erlang.system_info(:atom_count) - atoms < 500
    :erlang.garbage_collect()
    assert :erlang.memory(:total) - memory < 200_000_000
  end

  defp opened(path, bytes) do
    File.write!(path, bytes)

    with {:ok, store} <- Store.open(path) do
      for stream <- Store.streams(store) do
        case Store.read(store, stream.name, limit: 200) do
          {:ok, messages} -> for m <- messages, do: inspect(m, limit: 3)
          {:error, %Situ.Error{}} -> :ok
        end
      end
    else
      {:error, %Situ.Error{}} -> :ok
    end
  end

  for {name, extension, usual} <- [
        {"ros1_imu_gps_cam.mcap", ".mcap", 60},
        {"ros1_imu_gps_cam.bag", ".bag", 60}
      ] do
    test "survives mutations of #{name}", %{tmp_dir: dir} do
      bytes = File.read!(Path.join(@data, unquote(name)))
      path = Path.join(dir, "mutated" <> unquote(extension))
      bounded(Budget.mutation_count(unquote(usual)), &opened(path, mutate(bytes, &1)))
    end
  end

  test "survives mutations of an MCAP file with Foxglove's messages", %{tmp_dir: dir} do
    whole = Path.join(dir, "whole.mcap")
    pose = Situ.Pose.new({1.0, 2.0, 3.0})

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        file = Mcap.create(p, whole, compression: :none)

        for {topic, value} <- [
              {"/p", pose},
              {"/t", [Situ.Transform.new("a", "b", pose)]},
              {"/l", "words"}
            ] do
          p
          |> Situ.from_enumerable(for(i <- 1..20, do: {i, value}))
          |> Mcap.write(file, topic, encoding: :protobuf)
        end
      end)

    bytes = File.read!(whole)
    path = Path.join(dir, "mutated.mcap")
    bounded(Budget.mutation_count(200), &opened(path, mutate(bytes, &1)))
  end

  @sqlite System.find_executable("sqlite3")

  test "survives mutations of a ROS 2 bag in SQLite", %{tmp_dir: dir} do
    if @sqlite do
      whole = Path.join(dir, "whole.db3")

      sql = """
      create table topics(id integer primary key, name text, type text, serialization_format text,
        offered_qos_profiles text);
      create table messages(id integer primary key, topic_id integer, timestamp integer, data blob);
      insert into topics values (1, '/words', 'std_msgs/msg/String', 'cdr', '');
      with recursive n(i) as (select 1 union all select i + 1 from n where i < 40)
        insert into messages select i, 1, i * 1000, x'00010000060000006a75737421000000' from n;
      """

      {_, 0} = System.cmd(@sqlite, [whole, sql])
      bytes = File.read!(whole)
      path = Path.join(dir, "mutated.db3")
      bounded(Budget.mutation_count(60), &opened(path, mutate(bytes, &1)))
    end
  end

  test "survives mutations of Protobuf messages and their definitions" do
    schema = Messages.load_schema()
    value = %{Situ.PointCloud.from_points([{1.0, 2.0, 3.0}]) | colors: <<1, 2, 3>>}
    name = StandardTypes.message_type(value)
    {:ok, bytes} = Protobuf.encode(schema, name, StandardTypes.to_message(name, value, 5, "f"))
    set = Protobuf.Descriptor.encode_set(schema, name)

    bounded(Budget.mutation_count(2_000), fn n ->
      with {:ok, message} <- Protobuf.decode(schema, name, mutate(bytes, n)),
           do: StandardTypes.from_message(name, message)

      with {:ok, other} <- Protobuf.parse_schema(mutate(set, n)),
           true <- is_map_key(other.messages, name),
           do: Protobuf.decode(other, name, bytes)
    end)
  end

  test "survives mutations of ROS 1 and ROS 2 messages" do
    for {encoding, dialect} <- [ros1: :ros1, cdr: :ros2] do
      {:ok, text} = Library.fetch("sensor_msgs/PointCloud2", dialect)
      {:ok, definition} = Definition.parse("sensor_msgs/PointCloud2", text, dialect)
      cloud = Situ.PointCloud.from_points([{1.0, 2.0, 3.0}])
      message = Situ.Bridge.Ros.StandardTypes.to_message("sensor_msgs/PointCloud2", cloud, 5)
      {:ok, bytes} = Wire.encode(definition, message, encoding)

      bounded(Budget.mutation_count(2_000), fn n ->
        case Wire.decode(definition, mutate(bytes, n), encoding) do
          {:ok, message} ->
            Situ.Bridge.Ros.StandardTypes.from_message("sensor_msgs/PointCloud2", message)

          {:error, why} when is_binary(why) ->
            :ok
        end
      end)
    end
  end

  test "survives mutations of definitions" do
    {:ok, text} = Library.fetch("visualization_msgs/Marker")

    bounded(Budget.mutation_count(500), fn n ->
      case Definition.parse("visualization_msgs/Marker", mutate(text, n)) do
        {:ok, definition} -> Wire.decode(definition, :binary.copy(<<1>>, 100), :ros1)
        {:error, why} when is_binary(why) -> :ok
      end
    end)
  end

  test "survives mutations of MQTT and WebSocket conversations" do
    mqtt =
      IO.iodata_to_binary([
        <<0x20, 2, 0, 0>>,
        for(i <- 1..5, do: Mqtt.Wire.encode_publish("a/b", "payload", qos: rem(i, 3), id: i))
      ])

    {_hello, subscription} =
      Mqtt.Subscription.hello("h", 1, id: "a", topic: "a/b", qos: 2, version: 4)

    frames =
      IO.iodata_to_binary(for i <- 1..5, do: WebSocket.Frames.encode_frame(:text, "message #{i}"))

    bounded(Budget.mutation_count(2_000), fn n ->
      case Mqtt.Subscription.read(mutate(mqtt, n), subscription, 100_000) do
        {:ok, payloads, _answer, _state} when is_list(payloads) -> :ok
        {:reconnect, _why, _state} -> :ok
        {:error, why} when is_binary(why) -> :ok
      end

      case WebSocket.Frames.split_messages(mutate(frames, n), nil, false, 100_000) do
        {:ok, events, _rest, _begun} when is_list(events) -> :ok
        {:error, _why} -> :ok
      end
    end)
  end
end
