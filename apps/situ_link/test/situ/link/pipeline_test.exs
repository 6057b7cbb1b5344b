defmodule Situ.Link.PipelineTest do
  # Links as a pipeline sees them: positions, clocks and live streams.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  import Situ.Test.LinkRecordings
  alias Situ.{Clock, Delivery, Pipeline, Link, Time}
  alias Situ.Link.{Position, Server}
  alias Situ.Store.Writer

  setup do
    root = folder()
    {:ok, root: root, path: Path.join(root, "lobby")}
  end

  # A pipeline that sends the messages it receives to the test, and its link.
  defp follow(address, link_opts, stream_opts \\ [], more \\ fn stream, _link -> stream end) do
    me = self()

    {:ok, pipeline} =
      Pipeline.start_link(fn p ->
        link = Link.open(p, address, link_opts)
        send(me, {:link, link})

        link
        |> Link.stream("n", stream_opts)
        |> Situ.map(fn data -> data end)
        |> Situ.each(&send(me, {:got, &1}))
        |> more.(link)
      end)

    assert_receive {:link, link}
    {pipeline, link}
  end

  defp got(range), do: for(i <- range, do: assert_receive({:got, ^i}))

  test "a position is saved to a file and resumed from", %{root: root, path: path} do
    {writer, %{"n" => stream}} = begin(root, "lobby", %{"n" => messages(1..10)})
    server = serve(path)
    position = Path.join(root, "position.json")
    opts = [from: :resume, position: position, save_every: 10]
    {pipeline, _} = follow(address(server), opts)
    got(1..10)
    eventually(fn -> Position.load(position) == {:ok, %{"n" => 10}} end)
    {:ok, _} = Pipeline.stop(pipeline)

    {:ok, stream} = Writer.append(stream, messages(11..15))
    # The stream ends long before the next position is due.
    {pipeline, _} = follow(address(server), Keyword.put(opts, :save_every, 600_000))
    got(11..15)
    refute_received {:got, _}
    finish({writer, %{"n" => stream}})
    assert {:ok, _} = Pipeline.await(pipeline)
    eventually(fn -> Position.load(position) == {:ok, %{"n" => 15}} end)
  end

  test "the end of a pipeline saves its position before the next one is due", %{
    root: root,
    path: path
  } do
    finish(begin(root, "lobby", %{"n" => messages(1..10)}))
    position = Path.join(root, "position.json")
    opts = [from: :resume, position: position, save_every: 3_600_000]
    {pipeline, _} = follow(address(serve(path)), opts)
    got(1..10)
    assert {:ok, _} = Pipeline.await(pipeline)
    eventually(fn -> Position.load(position) == {:ok, %{"n" => 10}} end)
  end

  test "the position is the last confirmed message", %{root: root, path: path} do
    open = begin(root, "lobby", %{"n" => messages(1..10)})
    server = serve(path)
    position = Path.join(root, "position.json")
    opts = [from: :resume, position: position, save_every: 10]
    few = fn stream, link -> stream |> Situ.filter(&(&1 <= 7)) |> Link.confirm(link, "n") end
    {pipeline, _} = follow(address(server), opts, [], few)
    got(1..10)
    eventually(fn -> Position.load(position) == {:ok, %{"n" => 7}} end)
    {:ok, _} = Pipeline.stop(pipeline)
    {pipeline, _} = follow(address(server), opts)
    got(8..10)
    finish(open)
    assert {:ok, _} = Pipeline.await(pipeline)
  end

  test "an invalid position file is an error instead of a restart from the beginning", %{
    root: root,
    path: path
  } do
    finish(begin(root, "lobby", %{"n" => messages(1..3)}))
    server = serve(path)
    position = Path.join(root, "position.json")
    File.write!(position, ~s({"n": "yesterday"}))

    assert {:error, %{code: :bad_position}} =
             Pipeline.run(fn p ->
               Link.open(p, address(server), from: :resume, position: position)
             end)
  end

  test "detects a sender's clock that is ahead and converts its times to ours", %{
    root: root,
    path: path
  } do
    ahead = Time.s(90)
    now = Time.now()
    times = for i <- 1..20, do: now + ahead - Time.s(1) + Time.ms(i)
    open = begin(root, "lobby", %{"n" => messages(times)})
    server = serve(path, now: fn -> Time.now() + ahead end)
    # The estimate needs a round trip before the first message is converted.
    {pipeline, link} = follow(address(server), [from: :now], times: :local)
    eventually(fn -> match?(%{"n" => %{found?: true}}, Link.info(link).streams) end)
    eventually(fn -> Link.info(link).uncertainty != nil end)
    info = Link.info(link)
    assert abs(info.offset - ahead) <= info.uncertainty + Time.ms(1)

    {writer, %{"n" => stream}} = open
    sent = Time.now()
    {:ok, stream} = Writer.append(stream, messages([sent + ahead]))
    assert_receive {:got, _}

    finish({writer, %{"n" => stream}}, sent + ahead)
    assert {:ok, report} = Pipeline.await(pipeline)
    # The stream ends at its last message, by our clock.
    assert abs(report.final_time - sent) < Time.s(60)
  end

  test "live streams serve many clients, including a late one, and end", _context do
    me = self()
    clock = Clock.manual(Time.now())

    {:ok, pipeline} =
      Pipeline.start_link(
        fn p ->
          stream = Situ.event_source(p, fn post -> send(me, {:post, post}) end)
          {:ok, server} = Link.serve([{"n", stream}], port: 0, keep: Time.s(60))
          send(me, {:server, server})
        end,
        pipeline: [clock: clock]
      )

    assert_receive {:server, server}
    assert_receive {:post, post}
    post.(1)
    address = "situ://127.0.0.1:#{Server.port(server)}"
    {first, _} = follow(address, [from: :start], type: :any)
    got([1])

    # Live streams start at the oldest message that is still kept, across all segments.
    for i <- 2..5 do
      Clock.advance(clock, Time.s(10))
      post.(i)
      got([i])
    end

    {late, _} = follow(address, [from: :start], type: :any)
    got(1..5)
    {:ok, _} = Pipeline.stop(pipeline)
    assert {:ok, _} = Pipeline.await(first)
    assert {:ok, _} = Pipeline.await(late)
  end

  test "a quota limits outgoing data", %{root: root, path: path} do
    finish(begin(root, "lobby", %{"n" => messages(1..2_000)}))
    server = serve(path, quota: [{:messages_per_second, 4_000}, {:bytes_per_second, 10_000_000}])
    started = System.monotonic_time(:millisecond)
    assert length(received(address(server), "n")) == 2_000
    # Half a second of data, of which a tenth is free. Taking longer than that proves nothing.
    assert System.monotonic_time(:millisecond) - started >= 250
  end

  test "skips and counts data of another type than requested", %{
    root: root,
    path: path
  } do
    finish(
      begin(root, "lobby", %{
        "n" => messages(1..6, fn t -> if rem(t, 2) == 0, do: t, else: "odd" end)
      })
    )

    server = serve(path)
    assert received(address(server), "n", [from: :start], type: :integer) == [2, 4, 6]
  end

  # Uses a Unix socket, because a port that was free a moment ago may be taken by now.
  test "waits for a server that is not there yet", %{root: root, path: path} do
    finish(begin(root, "lobby", %{"n" => messages(1..3)}))
    socket = Path.join(root, "socket")

    capture_log(fn ->
      {pipeline, link} =
        follow("situ+unix://#{socket}?lobby", [from: :start, wait: 50],
          type: :integer,
          policy: Delivery.unlimited()
        )

      eventually(fn ->
        match?(%{connected?: false, error: %{code: :unreachable}}, Link.info(link))
      end)

      serve(path, port: :none, unix: socket)
      got(1..3)
      assert {:ok, _} = Pipeline.await(pipeline)
    end)
  end

  test "images arrive complete as datagrams, and every loss is reported", %{
    root: root,
    path: path
  } do
    picture = fn t -> {t, :binary.copy(<<rem(t, 251)>>, 30_000 + t)} end
    open = begin(root, "lobby", %{"n" => messages(1..200, picture)})
    server = serve(path, token: "s3cret")
    opts = [from: :start, token: "s3cret"]
    lossy = [policy: Delivery.max_queue(1_000), datagrams: true, type: :any]
    {pipeline, link} = follow(address(server), opts, lossy)

    eventually(fn ->
      told = Link.info(link).streams["n"]
      told != nil and told.received + told.lost >= 190
    end)

    finish(open)
    assert {:ok, _} = Pipeline.await(pipeline)
    got = all_got([])
    assert length(got) > 20
    assert Enum.all?(got, &(&1 == picture.(elem(&1, 0))))
    times = Enum.map(got, &elem(&1, 0))
    assert times == Enum.sort(Enum.uniq(times))
  end

  test "datagrams need a lossy policy; a Unix socket works without them", %{
    root: root,
    path: path
  } do
    finish(begin(root, "lobby", %{"n" => messages(1..5)}))
    socket = Path.join(root, "socket")
    serve(path, port: :none, unix: socket)
    there = "situ+unix://#{socket}?lobby"

    assert %{code: :bad_option} =
             assert_raise(Situ.Error, fn ->
               received(there, "n", [from: :start], datagrams: true)
             end)

    lossy = [policy: Delivery.max_queue(100), datagrams: 500]
    assert received(there, "n", [from: :start], lossy) == [1, 2, 3, 4, 5]
  end

  defp all_got(got) do
    receive do
      {:got, data} -> all_got([data | got])
    after
      0 -> Enum.reverse(got)
    end
  end
end
