defmodule Situ.Link.RecordingTest do
  # Recordings on another machine must give the same results as local ones.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog
  import Situ.Test.LinkRecordings
  import Situ.Test.SegmentFiles
  alias Situ.{Message, Link, Store}
  alias Situ.Link.Server
  alias Situ.Store.{Summary, Writer}

  doctest Situ.Link.Recording
  doctest Situ.Link.Access

  setup do
    root = folder()
    {:ok, root: root, path: Path.join(root, "lobby")}
  end

  defp ns(ms), do: ms * 1_000_000

  defp recorded(root) do
    {:ok, writer} = Writer.create("lobby", root)
    {:ok, n} = Writer.stream(writer, "n", type: :float)
    {:ok, _} = Writer.append(n, for(i <- 1..5_000, do: message(i, i * 0.5)))
    {:ok, door} = Writer.stream(writer, "door", type: :atom)

    {:ok, door} =
      Writer.append(
        door,
        for(i <- 1..40, do: message(i * 100, Enum.at([:ok, :error], rem(div(i, 10), 2))))
      )

    {:ok, big} = Writer.stream(writer, "big")

    picture = %Situ.Image{
      width: 1024,
      height: 1024,
      format: :rgb24,
      stride: 3072,
      data: :binary.copy(<<7>>, 3 * 1024 * 1024)
    }

    {:ok, _} = Writer.append(big, for(i <- 1..4, do: message(i, picture)))
    {:ok, _} = Writer.close_stream(door, ns(9_000))
    :ok = Writer.close(writer)
    writer.path
  end

  defp message(i, data),
    do: %Message{data: data, originating_time: ns(i), creation_time: ns(i) + 5, sequence_id: i}

  # A message's source is a number within its own recording.
  defp plain(messages), do: for(m <- messages, do: %{m | source_id: 0})

  test "a recording in segments is one recording, whose ordinals stay the same", %{
    root: root,
    path: path
  } do
    for first <- [1, 11, 21], do: write_segment(root, "lobby", %{"n" => first..(first + 8)})
    server = serve(path)
    here = Store.open!(path)
    there = server |> address() |> Store.open!()
    assert [%{name: "n", count: 27, first: 1, last: 29}] = Store.streams(there)

    assert plain(Enum.to_list(Store.messages(there, "n"))) ==
             plain(Enum.to_list(Store.messages(here, "n")))

    assert Summary.read(there, "n", 1, 29, 5) == Summary.read(here, "n", 1, 29, 5)
    assert {:ok, 12} = Store.ordinal(there, "n", 14)
    :ok = Store.delete(path <> ".0000")
    write_segment(root, "lobby", %{"n" => 31..39, "late" => [31]})
    assert {:ok, 12} = Store.ordinal(there, "n", 14)
    assert Store.has_stream?(there, "late")
    assert {:ok, %{data: 39}} = Store.at(there, "n", -1)
    # A client that connects later sees the same ordinals.
    assert {:ok, 12} = server |> address() |> Store.open!() |> Store.ordinal("n", 14)
  end

  test "every request to a recording returns the same as locally", %{root: root, path: path} do
    here = Store.open!(recorded(root))
    there = path |> serve() |> address() |> Store.open!()

    shown = fn store -> for i <- Store.streams(store), do: %{i | store_path: nil} end
    assert shown.(there) == shown.(here)
    assert Store.interval(there) == Store.interval(here)

    assert Map.take(Store.info(there), [:name, :closed?, :live?, :damage]) == %{
             name: "lobby",
             closed?: true,
             live?: false,
             damage: []
           }

    for name <- ["n", "door", "big"] do
      assert plain(Store.messages(there, name)) == plain(Store.messages(here, name))
    end

    for time <- [ns(0), ns(77), ns(77) + 1, ns(9_999)] do
      assert Store.ordinal(there, "n", time) == Store.ordinal(here, "n", time)
    end

    assert {:ok, %{data: 38.5}} = Store.latest_at(there, "n", ns(77) + 1)
    assert {:ok, [%{data: 2_500.0}]} = Store.read(there, "n", index: -1)
    assert Store.count(there, "n") == 5_000

    assert Store.summary(there, "n", 0, ns(5_000), 50) ==
             Store.summary(here, "n", 0, ns(5_000), 50)

    for name <- ["n", "door"], pixels <- [3, 300] do
      assert Summary.read(there, name, 0, ns(5_000), pixels) ==
               Summary.read(here, name, 0, ns(5_000), pixels)
    end

    assert Store.gaps(there, "door", ns(1)) == Store.gaps(here, "door", ns(1))
    assert Store.missing_files(there) == []
  end

  test "can be copied, played and listed", %{root: root, path: path} do
    here = Store.open!(recorded(root))
    server = serve(%{"lobby" => path, "hall" => path})
    assert {:ok, copy} = Store.copy(address(server), Path.join(root, "copy"))
    assert plain(Store.messages(Store.open!(copy), "n")) == plain(Store.messages(here, "n"))

    data = Situ.to_list(fn p -> p |> Store.importer(address(server)) |> Store.stream("door") end)

    assert data == for(m <- Store.messages(here, "door"), do: m.data)
    whole = "situ://127.0.0.1:#{Server.port(server)}"

    assert Enum.sort(Situ.Recording.Formats.list_recordings(whole)) == [
             whole <> "/hall",
             whole <> "/lobby"
           ]

    assert Situ.Recording.Formats.list_recordings(whole <> "/lobby") == [whole <> "/lobby"]
    assert Link.list_recordings(whole) == {:ok, [whole <> "/hall", whole <> "/lobby"]}
    assert Link.list_recordings(whole <> "/lobby") == {:ok, [whole <> "/lobby"]}
  end

  test "a version remains as it was opened, and another has its own address", %{
    root: root,
    path: path
  } do
    finish(begin(root, "lobby", %{"n" => messages(1..3)}))
    server = serve(path)
    first = Store.open!(address(server))
    finish(begin(root, "lobby", %{"n" => messages(4..9)}))

    numbers = fn store -> for m <- Store.messages(store, "n"), do: m.data end
    eventually(fn -> numbers.(Store.open!(address(server))) == [4, 5, 6, 7, 8, 9] end)
    assert numbers.(first) == [1, 2, 3]
    assert numbers.(Store.open!(address(server, "lobby.0000"))) == [1, 2, 3]

    capture_log(fn ->
      assert {:error, %{code: :no_recording}} = Store.open(address(server, "lobby.0007"))
    end)
  end

  test "a live recording sends updates, and a lost link ends nothing", %{
    root: root,
    path: path
  } do
    {writer, %{"n" => stream}} = begin(root, "lobby", %{"n" => messages(1..3)})
    socket = Path.join(root, "socket")
    settings = [port: :none, unix: socket]
    server = serve(path, settings)
    store = Store.open!("situ+unix://#{socket}?lobby")
    assert Store.live?(store)
    Store.notify(store, 0, 5)
    assert_receive {:situ_store, 5, {:published, n}}, 30_000
    Store.notify(store, n, 6)
    Server.close(server)
    assert {:error, %{code: code}} = Store.latest_at(store, "n", 2)
    assert code in [:link_lost, :unreachable]
    serve(path, settings)
    {:ok, stream} = Writer.append(stream, messages(4..6))
    assert_receive {:situ_store, 6, {:published, _}}, 30_000
    assert Store.count(store, "n") == 6
    Store.notify(store, 1_000_000, 7)
    finish({writer, %{"n" => stream}})
    assert_receive {:situ_store, 7, {:ended, _}}, 30_000
  end

  test "a missing or protected recording is an error", %{
    root: root,
    path: path
  } do
    recorded(root)
    server = serve(path, token: "s3cret")

    capture_log(fn ->
      assert {:error, %{code: :wrong_token}} = Store.open(address(server))
      token = [reader_opts: [token: "s3cret"]]

      assert {:error, %{code: :no_recording, fix: "use one of these names: lobby"}} =
               Store.open(address(server, "hall"), token)

      assert {:ok, store} = Store.open(address(server), token)
      assert {:error, %{code: :no_stream, what: what}} = Store.stream_info(store, "x")
      assert what == ~s(no stream "x" in lobby.0000)
    end)

    capture_log(fn ->
      whole = "situ://127.0.0.1:#{Server.port(server)}"
      assert {:error, %{code: :wrong_token}} = Link.list_recordings(whole)
      assert Link.list_recordings(whole, token: "s3cret") == {:ok, [whole <> "/lobby"]}
    end)

    assert {:error, %{code: :unreachable}} = Link.list_recordings("situ+unix://#{root}/nobody")
    assert {:error, %{code: :bad_address}} = Link.list_recordings("http://lab1")
    assert {:error, %{code: :unreachable}} = Store.open("situ+unix://#{root}/nobody?lobby")
    assert {:error, %{code: :bad_address}} = Store.open("situs://lab1/lobby?fingerprint=12")
    assert {:error, %{code: :no_store}} = Store.delete(address(server))
  end

  test "TLS with a self-signed certificate accepts only the fingerprint in the address",
       %{root: root, path: path} do
    recorded(root)
    {:ok, tls} = Situ.Link.Certificate.ensure_files(Path.join(root, "tls"), ["localhost"])
    server = serve(path, tls: tls)
    address = Server.address(server, "lobby")
    assert address =~ ~r"\Asitus://127\.0\.0\.1:\d+/lobby\?fingerprint=[0-9a-f]{64}\z"
    assert Store.count(Store.open!(address), "n") == 5_000
    assert length(received(address, "door")) == 40

    other = String.replace(address, ~r/[0-9a-f]{64}/, String.duplicate("0", 64))

    capture_log(fn ->
      assert {:error, %{code: :wrong_certificate, why: "its fingerprint is " <> _}} =
               Store.open(other)

      unknown = address |> String.split("?") |> hd()
      assert {:error, %{code: :wrong_certificate, fix: fix}} = Store.open(unknown)
      assert fix =~ "fingerprint"

      assert %{code: :wrong_certificate} =
               assert_raise(Situ.Error, fn -> received(other, "door") end)
    end)
  end

  test "a quota also applies to responses", %{root: root, path: path} do
    recorded(root)
    server = serve(path, quota: {:bytes_per_second, 20_000_000})
    store = Store.open!(address(server))
    started = System.monotonic_time(:millisecond)
    assert Enum.count(Store.messages(store, "big")) == 4
    # 12 MiB at 20 MB/s, of which a tenth of a second is free. Taking longer proves nothing.
    assert System.monotonic_time(:millisecond) - started >= 400
    assert is_map(Server.info(server))
    assert Link.peers() == []
  end
end
