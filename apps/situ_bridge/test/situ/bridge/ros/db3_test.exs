defmodule Situ.Bridge.Ros.Db3Test do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros.{Definition, Library, MessageIndex, Wire}
  alias Situ.Store
  alias Situ.Store.Undecoded
  doctest MessageIndex

  @moduletag :tmp_dir

  @tables """
  create table topics(id integer primary key, name text, type text, serialization_format text);
  create table messages(id integer primary key, topic_id integer, timestamp integer, data blob);
  """

  defp bag(dir, sql) do
    path = Path.join(dir, "drive.db3")
    {_, 0} = System.cmd("sqlite3", [path, @tables <> sql])
    path
  end

  defp insert(id, topic, time, bytes),
    do: "insert into messages values(#{id}, #{topic}, #{time}, x'#{Base.encode16(bytes)}');"

  defp float(x) do
    {:ok, text} = Library.fetch("std_msgs/Float64")
    {:ok, definition} = Definition.parse("std_msgs/Float64", text)
    {:ok, bytes} = Wire.encode(definition, %{"data" => x}, :cdr)
    bytes
  end

  test "opens topics as streams with their ROS 2 types", %{tmp_dir: dir} do
    rows = for i <- 1..50, do: insert(100 - i, 1, 1_000 + div(i, 2), float(i / 4))

    path =
      bag(dir, """
      insert into topics values(1, '/values', 'std_msgs/msg/Float64', 'cdr');
      insert into topics values(2, '/odd', 'my/msg/Thing', 'cdr');
      insert into topics values(3, '/empty', 'std_msgs/msg/Bool', 'cdr');
      #{rows}
      #{insert(1_000, 1, 5_000, "x")}
      #{insert(1_001, 2, 5_000, "abc")}
      """)

    store = Store.open!(path)
    counts = for s <- Store.streams(store), do: {s.name, s.type_name, s.count}

    assert counts == [
             {"/values", "std_msgs/Float64", 51},
             {"/odd", "my/Thing", 1},
             {"/empty", "std_msgs/Bool", 0}
           ]

    {:ok, messages} = Store.read(store, "/values")
    {values, [broken]} = Enum.split(messages, 50)
    assert values |> Enum.map(& &1.data) |> Enum.sort() == for(i <- 1..50, do: i / 4)
    times = Enum.map(messages, & &1.originating_time)
    assert times == Enum.sort(Enum.uniq(times))
    assert %Undecoded{} = broken.data
    assert {:ok, [%{data: "abc"}]} = Store.read(store, "/odd")
    assert [note] = Store.info(store).notes
    assert note =~ "/odd"
    assert {:ok, %{originating_time: 5_000}} = Store.latest_at(store, "/values", 9_000)
    assert {:ok, [%{data: %Undecoded{}}]} = Store.read(store, "/values", from: 2_000)
  end

  test "imports header times, and keeps recording times and all fields",
       context do
    definition = "geometry_msgs/PoseStamped"
    {:ok, text} = Library.fetch(definition, :ros2)
    {:ok, parsed} = Definition.parse(definition, text, :ros2)

    bytes = fn stamp ->
      header = %{"stamp" => stamp, "frame_id" => "map"}
      pose = %{"orientation" => %{"w" => 1.0}}
      {:ok, bytes} = Wire.encode(parsed, %{"header" => header, "pose" => pose}, :cdr)
      bytes
    end

    path =
      bag(context.tmp_dir, """
      insert into topics values(1, '/pose', 'geometry_msgs/msg/PoseStamped', 'cdr');
      #{insert(1, 1, 3_000_000_500, bytes.(2_000_000_900))}
      #{insert(2, 1, 3_000_000_600, bytes.(0))}
      """)

    {:ok, copy} = Store.copy(path, Path.join(context.tmp_dir, "copy"))
    store = Store.open!(copy)
    assert {:ok, [first, second]} = Store.read(store, "/pose")
    assert %{data: %Situ.Pose{}, originating_time: 2_000_000_900} = first
    assert first.creation_time == 3_000_000_500
    # Without a stamp, the time of recording is the originating time.
    assert %{originating_time: 3_000_000_600, creation_time: 3_000_000_600} = second
    assert {:ok, %{data: extra}} = Store.at(store, "/pose.extra", 0)
    assert extra["header"]["frame_id"] == "map"

    {:ok, copy} = Store.copy(path, Path.join(context.tmp_dir, "log"), times: :record)

    assert {:ok, %{originating_time: 3_000_000_500}} =
             copy |> Store.open!() |> Store.at("/pose", 0)
  end

  test "skips rows with values that are not numbers", %{tmp_dir: dir} do
    {:ok, text} = Library.fetch("geometry_msgs/PoseStamped", :ros2)
    {:ok, parsed} = Definition.parse("geometry_msgs/PoseStamped", text, :ros2)
    message = %{"header" => %{"stamp" => 2_000}, "pose" => %{"orientation" => %{"w" => 1.0}}}
    {:ok, bytes} = Wire.encode(parsed, message, :cdr)

    path =
      bag(dir, """
      insert into topics values(1, '/pose', 'geometry_msgs/msg/PoseStamped', 'cdr');
      #{insert(1, 1, 3_000, bytes)}
      insert into messages values(2, 1, '4' || char(31) || '5', x'00');
      insert into messages values(3, 1, '6' || char(30) || '7', x'00');
      insert into messages values(-4, 1, 8, x'00');
      insert into messages values(5, 1, 9, null);
      """)

    for times <- [:log, :header] do
      store = Store.open!(path, reader_opts: [times: times])
      assert Store.count(store, "/pose") == 1
      assert {:ok, [%{data: %Situ.Pose{}}]} = Store.read(store, "/pose")
    end
  end

  test "rejects a file that is not a bag, and says why", %{tmp_dir: dir} do
    path = Path.join(dir, "x.db3")
    File.write!(path, "no database at all, but long enough to be looked at")
    assert {:error, %{code: :not_bag}} = Store.open(path)
    File.write!(path, "")
    assert {:error, %{code: :not_bag}} = Store.open(path)
    assert {:error, _} = Store.open(Path.join(dir, "nothing.db3"))
  end
end
