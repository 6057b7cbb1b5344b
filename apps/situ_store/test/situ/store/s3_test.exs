defmodule Situ.Store.S3Test do
  use ExUnit.Case, async: false

  alias Situ.{Error, Store, Time}
  alias Situ.Store.{S3, Writer}
  alias Situ.Store.S3.{Cache, Client, Cost, Eviction, MirrorFile}
  alias Situ.Store.Test.ObjectServer

  @moduletag :tmp_dir
  @moduletag :object_port

  setup %{tmp_dir: dir} = context do
    {:ok, server} = start_supervised({ObjectServer, page: context[:page]})

    put_environment(%{
      "AWS_ENDPOINT_URL" => ObjectServer.url(server),
      "AWS_ACCESS_KEY_ID" => "AKIATEST",
      "AWS_SECRET_ACCESS_KEY" => "very-secret",
      "SITU_S3_TIMEOUT" => "2",
      "SITU_S3_CACHE" => Path.join(dir, "cache")
    })

    restart_program()
    %{server: server, root: Path.join(dir, "recordings")}
  end

  defp put_environment(values) do
    before = Map.new(values, fn {name, _} -> {name, System.get_env(name)} end)
    System.put_env(values)

    on_exit(fn ->
      for {name, value} <- before,
          do: if(value, do: System.put_env(name, value), else: System.delete_env(name))

      restart_program()
    end)
  end

  # The program reads the environment when it starts.
  defp restart_program do
    :ok = Supervisor.terminate_child(Situ.Store.Supervisor, Client)
    {:ok, _} = Supervisor.restart_child(Situ.Store.Supervisor, Client)
  end

  # A minute with an image of 200 KB each second, in one extent of 12 MB, and 6,000 numbers.
  defp write_store(root, name \\ "lobby", seed \\ 1, seconds \\ 60) do
    {:ok, writer} = Writer.create(name, root, first_extent: 16 * 1024 * 1024)
    {:ok, video} = Writer.stream(writer, "Video")
    {:ok, numbers} = Writer.stream(writer, "Loudness", type: :float)

    Enum.reduce(0..(seconds - 1), {video, numbers}, fn n, {video, numbers} ->
      {:ok, video} = Writer.append(video, [message(image(n, seed), Time.s(n))])
      values = for m <- 0..99, do: message(n + m / 100, Time.s(n) + Time.ms(10 * m))
      {:ok, numbers} = Writer.append(numbers, values)
      {video, numbers}
    end)

    :ok = Writer.close(writer)
    writer.path
  end

  defp image(n, seed),
    do:
      for(<<byte <- :crypto.hash(:sha256, <<n, seed>>)>>,
        into: "",
        do: :binary.copy(<<byte>>, 6_250)
      )

  defp message(data, time),
    do: %Situ.Message{
      data: data,
      originating_time: time,
      creation_time: time,
      sequence_id: div(time, 10_000_000) + 1
    }

  defp push!(root, name \\ "lobby") do
    write_store(root, name)
    {:ok, report} = S3.push(Path.join(root, name), "s3://lab/rec/")
    report
  end

  defp count_cost(run) do
    {result, cost} = Cost.measure(run)
    {result, cost.reads + cost.writes}
  end

  test "a pushed recording opens at its address, with the same contents", %{root: root} do
    report = push!(root)
    assert report.copied == ["s3://lab/rec/lobby.0000"]
    assert report.cost.sent > 12_000_000
    store = Store.open!("s3://lab/rec/lobby")
    local = Store.open!(Path.join(root, "lobby"))
    assert store.path == "s3://lab/rec/lobby"
    assert Map.delete(Store.info(store), :synced) == Map.delete(Store.info(local), :synced)

    for name <- ["Video", "Loudness"] do
      assert Enum.to_list(Store.messages(store, name)) ==
               Enum.to_list(Store.messages(local, name))
    end

    assert Store.missing_files(store) == []
    assert {:ok, %{damage: []}} = Store.verify("s3://lab/rec/lobby.0000")
    assert Store.list("s3://lab/rec") == ["s3://lab/rec/lobby.0000"]
    assert Store.list("s3://lab", recursive: true) == ["s3://lab/rec/lobby.0000"]
  end

  test "the first image takes at most five requests and a seek three", %{
    server: server,
    root: root
  } do
    push!(root)
    ObjectServer.take_requests(server)
    store = Store.open!("s3://lab/rec/lobby")
    streams = Store.streams(store)
    assert {:ok, _, [_ | _]} = Store.summary(store, "Loudness", 0, Time.s(60), 500)
    assert {:ok, %{data: data}} = Store.latest_at(store, "Video", Time.s(30))
    assert data == image(30, 1)
    assert length(streams) == 2
    assert length(ObjectServer.take_requests(server)) <= 5

    for time <- [Time.s(50), Time.s(3), Time.s(20)] do
      assert {:ok, %{originating_time: ^time}} = Store.latest_at(store, "Video", time)
      assert {:ok, %{}} = Store.latest_at(store, "Loudness", time)
      assert length(ObjectServer.take_requests(server)) <= 3
    end

    # Fetched blocks stay in the cache, also for programs that start later.
    again = Store.open!("s3://lab/rec/lobby")
    assert {:ok, %{}} = Store.latest_at(again, "Video", Time.s(50))
    assert [{"GET", "lab"}] = ObjectServer.take_requests(server)
  end

  test "reading in order reads ahead", %{server: server, root: root} do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    ObjectServer.take_requests(server)
    for n <- 0..59, do: assert({:ok, %{}} = Store.at(store, "Video", n))
    assert length(ObjectServer.take_requests(server)) < 15
  end

  test "summaries and gaps fetch only summaries", %{root: root} do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    local = Store.open!(Path.join(root, "lobby"))

    {remote, requests} =
      count_cost(fn ->
        for info <- Store.streams(store), do: Store.gaps(store, info, Time.ms(500))
      end)

    assert remote == for(info <- Store.streams(local), do: Store.gaps(local, info, Time.ms(500)))
    assert requests <= 2

    for {from, to} <- [{0, 60}, {10, 12}, {59, 60}] do
      span = [Time.s(from), Time.s(to), 300]

      assert apply(Store, :summary, [store, "Loudness" | span]) ==
               apply(Store, :summary, [local, "Loudness" | span])
    end
  end

  test "segments are one recording", %{root: root, server: server} do
    {:ok, _} =
      Situ.Pipeline.run(
        fn p ->
          store = Store.create(p, "hall", root, split: 30_000)
          p |> Situ.from_enumerable(0..99, every: 1_000) |> Store.write(store, "N")
        end,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

    {:ok, %{copied: copied}} = S3.push(Path.join(root, "hall"), "s3://lab/hall")
    assert length(copied) == 4
    assert S3.list("s3://lab/") == {:ok, ["s3://lab/hall"]}
    store = Store.open!("s3://lab/hall")
    assert Enum.map(Store.messages(store, "N"), & &1.data) == Enum.to_list(0..99)
    assert length(Store.segments(store)) == 4
    assert Store.count(Store.open!("s3://lab/hall.0001"), "N") == 30

    {:ok, %{copied: copied}} = S3.pull("s3://lab/hall", Path.join(root, "copies/hall"))
    assert length(copied) == 4
    copy = Store.open!(Path.join(root, "copies/hall"))
    assert Enum.map(Store.messages(copy, "N"), & &1.data) == Enum.to_list(0..99)

    # Retention by age, of each name.
    {:ok, %{deleted: deleted, present: present}} = S3.sync(root, "s3://lab", keep: 35_000)
    assert deleted == ["s3://lab/hall.0000", "s3://lab/hall.0001"]
    assert length(present) == 4
    refute Enum.any?(ObjectServer.keys(server), &(&1 =~ "hall.0000"))

    assert Enum.map(Store.messages(Store.open!("s3://lab/hall"), "N"), & &1.data) ==
             Enum.to_list(60..99)
  end

  test "a recording that is being pushed is not there yet", %{server: server, root: root} do
    write_store(root)

    ObjectServer.put_fault(server, fn request ->
      if request.method == "PUT" and request.key =~ ~r/lobby.0000.situ\z/, do: {:status, 403}
    end)

    assert {:error, %Error{}} = S3.push(Path.join(root, "lobby"), "s3://lab/rec/lobby")
    assert Enum.any?(ObjectServer.keys(server), &(&1 =~ "large-000000"))
    assert S3.list("s3://lab/rec") == {:ok, []}
    assert {:error, %Error{code: :no_store}} = Store.open("s3://lab/rec/lobby")
    ObjectServer.put_fault(server, fn _ -> nil end)
    ObjectServer.take_requests(server)

    # The files are not sent again.
    assert {:ok, %{copied: [_], cost: %{sent: sent}}} =
             S3.push(Path.join(root, "lobby"), "s3://lab/rec/lobby")

    assert sent < 1_000_000
    assert {:ok, ["s3://lab/rec/lobby.0000"]} = S3.list("s3://lab/rec")
  end

  test "a push continues after the program was killed", %{server: server, root: root} do
    write_store(root)
    test = self()

    # The second part never ends, so the program is killed in the middle of the upload.
    ObjectServer.put_fault(server, fn request ->
      if request.query["partNumber"] == "2" do
        send(test, :second_part)
        :hang
      end
    end)

    push = Task.async(fn -> S3.push(Path.join(root, "lobby"), "s3://lab/rec/lobby") end)
    assert_receive :second_part
    await_journal(Path.join(System.get_env("SITU_S3_CACHE"), "uploads"))
    kill_program()
    assert {:error, %Error{code: :object_port_ended}} = Task.await(push, 30_000)
    ObjectServer.put_fault(server, fn _ -> nil end)
    ObjectServer.take_requests(server)

    assert {:ok, %{copied: [_], cost: %{sent: sent}}} =
             S3.push(Path.join(root, "lobby"), "s3://lab/rec/lobby")

    assert sent < 5_000_000
    assert {:ok, %{damage: []}} = Store.verify("s3://lab/rec/lobby")
  end

  # Waits until the first part is in the journal.
  defp await_journal(folder) do
    lines =
      folder |> Path.join("*.situ") |> Path.wildcard() |> Enum.map(&File.read!/1) |> Enum.join()

    unless lines =~ "etag", do: await_journal(folder)
  end

  defp kill_program do
    %{port: port} = :sys.get_state(Client)
    {:os_pid, pid} = Port.info(port, :os_pid)
    {_, 0} = System.cmd("kill", ["-9", Integer.to_string(pid)])
  end

  test "a pull continues after the program was killed", %{server: server, root: root} do
    push!(root)
    test = self()
    counter = :counters.new(1, [])

    ObjectServer.put_fault(server, fn request ->
      if request.method == "GET" and request.key =~ "large", do: :counters.add(counter, 1, 1)

      if :counters.get(counter, 1) == 2 do
        send(test, :second_range)
        :hang
      end
    end)

    target = Path.join(root, "copies/lobby")
    pull = Task.async(fn -> S3.pull("s3://lab/rec/lobby", target) end)
    assert_receive :second_range
    kill_program()
    assert {:error, %Error{code: :object_port_ended}} = Task.await(pull, 30_000)
    assert Store.list(Path.dirname(target)) == []
    ObjectServer.put_fault(server, fn _ -> nil end)
    assert {:ok, %{copied: [path]}} = S3.pull("s3://lab/rec/lobby", target)
    assert path == target <> ".0000"
    assert {:ok, %{damage: []}} = Store.verify(path)

    assert File.read!(Path.join(path, "index.situ")) ==
             File.read!(Path.join([root, "lobby.0000", "index.situ"]))

    assert {:ok, %{copied: [], present: [_]}} = S3.pull("s3://lab/rec/lobby", target)
  end

  test "errors of the service and broken connections are retried", %{server: server, root: root} do
    faulty = fn ->
      counter = :counters.new(1, [])

      ObjectServer.put_fault(server, fn _ ->
        :counters.add(counter, 1, 1)

        case rem(:counters.get(counter, 1), 4) do
          1 -> {:status, 503}
          3 -> {:cut, 10}
          _ -> nil
        end
      end)
    end

    write_store(root)
    faulty.()
    assert {:ok, %{copied: [_]}} = S3.push(Path.join(root, "lobby"), "s3://lab/rec/lobby")
    faulty.()
    store = Store.open!("s3://lab/rec/lobby")
    assert {:ok, %{data: data}} = Store.latest_at(store, "Video", Time.s(30))
    assert data == image(30, 1)
  end

  test "bytes with a wrong checksum are fetched again and never kept", %{
    server: server,
    root: root
  } do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    counter = :counters.new(1, [])

    ObjectServer.put_fault(server, fn _ ->
      :counters.add(counter, 1, 1)
      if :counters.get(counter, 1) == 1, do: :corrupt
    end)

    assert {:ok, %{data: data}} = Store.latest_at(store, "Video", Time.s(30))
    assert data == image(30, 1)
    ObjectServer.put_fault(server, fn _ -> :corrupt end)

    assert {:error, %Error{code: :damaged, why: why}} =
             Store.latest_at(store, "Video", Time.s(50))

    assert why =~ "wrong checksum"
    ObjectServer.put_fault(server, fn _ -> nil end)
    assert {:ok, %{data: data}} = Store.latest_at(store, "Video", Time.s(50))
    assert data == image(50, 1)
  end

  test "a service that does not respond is an error, and reading continues when it does", %{
    server: server,
    root: root
  } do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    ObjectServer.put_fault(server, fn _ -> {:status, 503} end)

    assert {:error, %Error{code: :unreachable, what: what}} =
             Store.latest_at(store, "Video", Time.s(30))

    assert what =~ "s3://lab/rec/lobby.0000/large-000000.situ"
    ObjectServer.put_fault(server, fn _ -> nil end)
    assert {:ok, %{}} = Store.latest_at(store, "Video", Time.s(30))
  end

  test "a connection that falls silent is replaced", %{server: server, root: root} do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    counter = :counters.new(1, [])

    ObjectServer.put_fault(server, fn _ ->
      :counters.add(counter, 1, 1)
      if :counters.get(counter, 1) == 1, do: {:stall, 1_000}
    end)

    assert {:ok, %{data: data}} = Store.latest_at(store, "Video", Time.s(30))
    assert data == image(30, 1)
  end

  test "an object that was replaced under a reader is an error", %{server: server, root: root} do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    [key] = for key <- ObjectServer.keys(server), key =~ "large-000000", do: key
    bytes = ObjectServer.get_object(server, key)
    ObjectServer.put_object(server, key, :binary.copy(<<0>>, byte_size(bytes)))
    assert {:error, %Error{code: :store_replaced}} = Store.latest_at(store, "Video", Time.s(30))
  end

  test "another recording at the address is never replaced", %{root: root} do
    push!(root)
    other = Path.join(root, "other")
    write_store(other, "lobby", 2)

    assert {:error, %Error{code: :store_exists}} =
             S3.push(Path.join(other, "lobby"), "s3://lab/rec/lobby")

    assert {:error, %Error{code: :store_exists}} =
             S3.pull("s3://lab/rec/lobby", Path.join(other, "lobby"))

    assert {:ok, %{deleted: ["s3://lab/rec/lobby.0000"]}} = S3.delete("s3://lab/rec/lobby")
    assert {:ok, %{copied: [_]}} = S3.push(Path.join(other, "lobby"), "s3://lab/rec/lobby")

    assert {:ok, %{data: data}} =
             Store.latest_at(Store.open!("s3://lab/rec/lobby"), "Video", Time.s(1))

    assert data == image(1, 2)
  end

  @tag page: 2
  test "sync copies what is missing, in both directions", %{root: root} do
    for n <- 1..3, do: write_store(root, "day#{n}", 1, 2)
    {:ok, _writer} = Writer.create("live", root)
    {:ok, report} = S3.sync(root, "s3://lab/days")
    assert length(report.copied) == 3
    assert [live] = report.unfinished
    assert live =~ "live.0000"
    assert {:ok, %{copied: [], present: [_, _, _]}} = S3.sync(root, "s3://lab/days")
    copies = Path.join(root, "copies")
    assert {:ok, %{copied: [_, _, _]}} = S3.sync("s3://lab/days", copies)
    assert Enum.map(Store.list(copies), &Path.basename/1) == ~w(day1.0000 day2.0000 day3.0000)
    assert {:error, %Error{code: :bad_address}} = S3.sync(root, copies)
  end

  test "the cache is limited, and readers of emptied extents fetch again", %{root: root} do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    assert Enum.count(Store.messages(store, "Video")) == 60
    mirrors = Path.wildcard(Path.join(Cache.root(), "objects/*/large-*.mirror"))
    assert mirrors |> Enum.map(&MirrorFile.fetched_bytes/1) |> Enum.sum() > 11_000_000
    Eviction.limit_size(0)
    assert mirrors |> Enum.map(&MirrorFile.fetched_bytes/1) |> Enum.sum() == 0
    fresh = Store.open!("s3://lab/rec/lobby")

    for reader <- [store, fresh] do
      assert {:ok, %{data: data}} = Store.latest_at(reader, "Video", Time.s(30))
      assert data == image(30, 1)
    end
  end

  test "a copy of a remote recording is copied without loss", %{root: root} do
    push!(root)

    {:ok, path} =
      Store.crop("s3://lab/rec/lobby", Path.join(root, "part"), from: Time.s(10), to: Time.s(19))

    assert Store.count(Store.open!(path), "Video") == 10
    assert {:ok, %{damage: []}} = Store.verify(path)
  end

  test "credentials appear nowhere", %{server: server, root: root} do
    push!(root)

    ObjectServer.put_fault(server, fn _ -> {:status, 403} end)
    assert {:error, %Error{code: :not_permitted} = error} = Store.open("s3://lab/rec/lobby")
    refute inspect(error) =~ ~r/AKIATEST|very-secret/
    {:os_pid, pid} = Port.info(:sys.get_state(Client).port, :os_pid)
    refute File.read!("/proc/#{pid}/cmdline") =~ ~r/AKIATEST|very-secret/
    assert {:error, error} = Store.open("s3://AKIATEST:very-secret@lab/rec")
    refute Exception.message(error) =~ "very-secret"
    cached = Path.wildcard(Path.join(System.get_env("SITU_S3_CACHE"), "**/*.json"))
    refute Enum.any?(cached, &(File.read!(&1) =~ ~r/AKIATEST|very-secret/))
  end

  test "without credentials, nothing is sent", %{server: server} do
    System.delete_env("AWS_ACCESS_KEY_ID")
    System.put_env("HOME", "/nowhere")
    restart_program()
    assert {:error, %Error{code: :no_credentials}} = Store.open("s3://lab/rec/lobby")
    assert ObjectServer.take_requests(server) == []
  end

  test "credentials come from a profile, too", %{server: server, tmp_dir: dir} do
    file = Path.join(dir, "credentials")

    File.write!(
      file,
      "[default]\naws_access_key_id = no\n[lab]\naws_access_key_id = KEY2\naws_secret_access_key = s\n"
    )

    put_environment(%{"AWS_PROFILE" => "lab", "AWS_SHARED_CREDENTIALS_FILE" => file})
    System.delete_env("AWS_ACCESS_KEY_ID")
    restart_program()
    test = self()

    ObjectServer.put_fault(server, fn request ->
      send(test, {:authorization, request.headers["authorization"]})
      nil
    end)

    assert {:ok, []} = S3.list("s3://lab/rec")
    assert_receive {:authorization, "AWS4-HMAC-SHA256 Credential=KEY2/" <> _}
    System.put_env("AWS_PROFILE", "none")
    restart_program()
    assert {:error, %Error{code: :no_credentials, why: why}} = S3.list("s3://lab/rec")
    assert why =~ "none"
  end

  test "a folder from elsewhere does not decide what is fetched", %{server: server, root: root} do
    push!(root)
    store = Store.open!("s3://lab/rec/lobby")
    foreign = Path.join(root, "foreign.0000")
    File.cp_r!(store.state.path, foreign)
    ObjectServer.take_requests(server)
    assert {:error, %Error{}} = Store.latest_at(Store.open!(foreign), "Video", Time.s(30))
    assert ObjectServer.take_requests(server) == []
  end
end
