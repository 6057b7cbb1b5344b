# Situ's side of test/bridge: `situ.exs COMMAND ARGUMENTS`.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.{Arrow, Mcap, Parquet, Ros, Ros.Bag, ZeroMQ}
alias Situ.Store

value = fn
  %{"value" => value} -> value
  value -> value
end

read = fn paths ->
  for path <- paths do
    store = Store.open!(path)
    {:ok, messages} = Store.read(store, "/values", limit: 10_000)
    [] = Store.info(store).damage
    expected = for i <- 0..499, do: {1_000_000_000 + i * 1_000_000, i / 4}
    ^expected = for m <- messages, do: {m.originating_time, value.(m.data)}
    IO.puts("#{path}: #{length(messages)} messages")
  end
end

until_there = fn again, path ->
  unless File.exists?(path) do
    Process.sleep(50)
    again.(again, path)
  end
end

case System.argv() do
  ["mcap", bag, to] ->
    store = Store.open!(bag)

    for compression <- [:none, :lz4, :zstd],
        do:
          {:ok, 545} =
            Mcap.export(store, Path.join(to, "out-#{compression}.mcap"),
              compression: compression,
              chunk: 10_000
            )

    {:ok, 545} = Bag.export(store, Path.join(to, "out.bag"), chunk: 20_000)
    {:ok, 545} = Bag.export(store, Path.join(to, "out-lz4.bag"), compression: :lz4)

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(for(i <- 1..100, do: {i * 100, %{"n" => i, "x" => i / 3}}))
        |> Situ.Bridge.File.write(Path.join(to, "out.msgpack"), format: :message_pack)
      end)

  ["read" | paths] ->
    read.(paths)

  ["write_parquet", dir] ->
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "rows", dir)

        rows =
          for n <- 1..1_000 do
            text = if rem(n, 3) != 0, do: "text #{rem(n, 10)}"
            {n * 1_000, %{n: n, t: text, b: rem(n, 2) == 0, p: %{x: n / 4}}}
          end

        nested =
          for {t, row} <- rows, do: {t, %{p: row.p, l: if(row.t, do: [row.n, nil], else: [])}}

        p |> Situ.from_enumerable(nested) |> Store.write(store, "Nested")
        p |> Situ.from_enumerable(rows) |> Store.write(store, "Rows")
      end)

    store = Store.open!(Path.join(dir, "rows"))
    {:ok, 1_000} = Parquet.write(store, "Nested", Path.join(dir, "nested.parquet"), nested: true)
    rows = [streams: ["Rows"]]
    {:ok, %{"Rows" => 1_000}} = Parquet.export(store, dir, [rows: 300] ++ rows)
    {:ok, _} = Parquet.export(store, Path.join(dir, "gz"), compression: :gzip)
    {:ok, %{"Rows" => 1_000}} = Arrow.export(store, dir, [rows: 300] ++ rows)

  ["read_tables", own | theirs] ->
    rows = Enum.to_list(Parquet.messages(own))
    1_000 = length(rows)

    for path <- theirs do
      module = if Path.extname(path) == ".parquet", do: Parquet, else: Arrow
      true = Enum.to_list(module.messages(path)) == rows
      IO.puts(path)
    end

  ["read_ros2" | paths] ->
    for path <- paths do
      store = Store.open!(path)

      {:ok, [%{data: %Situ.Image{width: 4, height: 2, format: :rgb24, data: data}}]} =
        Store.read(store, "/image")

      ^data = :binary.copy(<<1, 2, 3>>, 8)
      {:ok, imu} = Store.read(store, "/imu")
      20 = length(imu)
      [3.5 | _] = for %{data: %Situ.ImuReading{acceleration: {_, _, z}}} <- imu, do: z
      maps = Store.open!(path, reader_opts: [messages: :maps])
      {:ok, imu} = Store.read(maps, "/imu")
      [5_000_000_007 | _] = for %{data: m} <- imu, do: m["header"]["stamp"]
    end

  ["publish", port] ->
    values = for i <- 1..2_000, do: {i * 1_000, %{"n" => i}}

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(values)
        |> ZeroMQ.publish("tcp://127.0.0.1:#{port}",
          topic: "levels",
          wait_for: 1,
          high_water_mark: 100_000
        )
      end)

  ["subscribe", port] ->
    me = self()

    {:ok, p} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> ZeroMQ.subscribe("tcp://127.0.0.1:#{port}", topic: "a")
        |> Situ.each(&send(me, {:got, &1}))
      end)

    got =
      for _ <- 1..2_000,
          do: receive(do: ({:got, n} -> n), after: (60_000 -> raise("nothing more came")))

    true = got == Enum.to_list(1..2_000)
    {:ok, _} = Situ.Pipeline.stop(p)

  # Receives from rospy's node, reports it with a file, and receives again after the master and
  # the node were killed.
  ["ros1_subscribe", port, file] ->
    me = self()
    master = "http://127.0.0.1:#{port}"

    {:ok, p} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Ros.subscribe("/imu", master: master)
        |> Situ.map(fn %{acceleration: {_, _, z}}, m -> {m.originating_time, z} end)
        |> Situ.each(&send(me, {:got, &1}))
      end)

    hear = fn ->
      receive do
        {:got, {time, z}} ->
          n = round(z * 2)
          ^time = n * 1_000_000_000 + 7
          n
      after
        60_000 -> raise("nothing more came")
      end
    end

    first = for _ <- 1..100, do: hear.()
    true = first == Enum.to_list(hd(first)..List.last(first))
    File.write!(file, "")
    # The second node counts from 1,000,000.
    later = fn later -> if hear.() >= 1_000_000, do: :ok, else: later.(later) end
    :ok = later.(later)
    for _ <- 1..50, do: hear.()
    {:ok, _} = Situ.Pipeline.stop(p)

  ["ros1_peer", port] ->
    opts = [master: "http://127.0.0.1:#{port}"]
    set_bool = "bool data\n---\nbool success\nstring message"
    :ok = Ros.set_param("/from_situ", [1, "two", %{"x" => 1.5}], opts)
    me = self()

    answer = fn request ->
      send(me, :called)
      {:ok, %{"success" => not request["data"], "message" => "from situ"}}
    end

    {:ok, server} = Ros.serve("/flip_ours", "std_srvs/SetBool", set_bool, answer, opts)

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        pictures =
          for i <- 1..50 do
            data = :binary.copy(<<i, 2, 3>>, 8)
            image = Situ.Image.new!(width: 4, height: 2, format: :rgb24, data: data)
            {i * 1_000_000_000 + 5, image}
          end

        p
        |> Situ.from_enumerable(pictures, type: Situ.Image)
        |> Ros.publish("/pictures", [wait_for: 1, linger: 10_000] ++ opts)
      end)

    # When a publisher ends, its last images may still be in flight.
    large =
      Situ.Image.new!(
        width: 1280,
        height: 720,
        format: :rgb24,
        data: :crypto.strong_rand_bytes(2_764_800)
      )

    {:ok, watching} =
      Situ.Pipeline.start_link(fn p ->
        p |> Ros.subscribe("/large", opts) |> Situ.each(&send(me, {:large, &1 == large}))
      end)

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(for(i <- 1..20, do: {i * 1_000_000_000, large}), type: Situ.Image)
        |> Ros.publish("/large", [wait_for: 1, linger: 20_000] ++ opts)
      end)

    for n <- 1..20,
        do:
          receive(
            do: ({:large, true} -> :ok),
            after: (20_000 -> raise("picture #{n} did not come"))
          )

    {:ok, _} = Situ.Pipeline.stop(watching)

    {:ok, %{"success" => true, "message" => "from rospy"}} =
      Ros.call("/flip_theirs", set_bool, %{"data" => false}, opts)

    {:error, %{code: :ros_refused}} = Ros.call("/nothing", set_bool, %{}, opts)

    {:error, %{code: :ros_refused}} =
      Ros.call("/flip_theirs", "int8 x\n---\nint8 y", %{"x" => 1}, opts)

    {:ok, %{"list" => [1, 2.5, "three", true]}} = Ros.get_param("/from_rospy", opts)
    :ok = Ros.set_param("/done", true, opts)
    {:ok, topics} = Ros.list_topics(opts)
    false = List.keymember?(topics, "/pictures", 0)

    # The other side may not be ready yet.
    receive do
      :called -> :ok
    after
      60_000 -> raise("nobody called /flip_ours")
    end

    Ros.stop(server)

  # Serves a recording until the file `done` exists.
  ["foxglove", dir] ->
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "drive", dir)
        values = for i <- 0..99, do: {1_000_000_000 + i * 10_000_000, %{"n" => i}}
        p |> Situ.from_enumerable(values) |> Store.write(store, "Values")
        image = Situ.Image.new!(width: 1, height: 1, format: :rgb24, data: <<1, 2, 3>>)

        p
        |> Situ.from_enumerable([{1_000_000_000, image}], type: Situ.Image)
        |> Store.write(store, "Camera")
      end)

    {:ok, server} = Situ.Bridge.Foxglove.serve(Path.join(dir, "drive"), port: 0)
    File.write!(Path.join(dir, "port.tmp"), to_string(Situ.Bridge.Foxglove.port(server)))
    File.rename!(Path.join(dir, "port.tmp"), Path.join(dir, "port"))
    until_there.(until_there, Path.join(dir, "done"))

  ["push", port] ->
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        p
        |> Situ.from_enumerable(for(i <- 1..2_000, do: {i, i}))
        |> ZeroMQ.push("tcp://127.0.0.1:#{port}", wait_for: 1, linger: 30_000)
      end)
end
