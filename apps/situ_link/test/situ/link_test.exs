defmodule Situ.LinkTest do
  use ExUnit.Case, async: true
  alias Situ.Link
  alias Situ.Link.Server
  alias Situ.Store.Writer
  doctest Link

  setup do
    root = Path.join(System.tmp_dir!(), "situ-link-#{System.unique_integer([:positive])}")
    File.mkdir_p!(root)
    on_exit(fn -> File.rm_rf!(root) end)
    {:ok, root: root}
  end

  defp record(root, name, times, opts \\ []) do
    {:ok, writer} = Writer.create(name, root)
    {:ok, stream} = Writer.stream(writer, "n", type: :integer)
    {:ok, stream} = Writer.append(stream, messages(times))
    if opts[:open], do: {writer, stream}, else: finish({writer, stream}, Enum.max(times))
  end

  defp messages(times) do
    for t <- times,
        do: %Situ.Message{data: t, originating_time: t, creation_time: t, sequence_id: t}
  end

  defp finish({writer, stream}, time) do
    {:ok, _} = Writer.close_stream(stream, time)
    :ok = Writer.close(writer)
  end

  defp serve(what, opts \\ []) do
    {:ok, server} = Link.serve(what, Keyword.merge([port: 0], opts))
    on_exit(fn -> Server.close(server) end)
    server
  end

  defp address(server, name \\ "lobby"), do: "situ://127.0.0.1:#{Server.port(server)}/#{name}"

  defp received(address, link_opts, stream_opts \\ []) do
    Situ.to_list(fn p ->
      p |> Link.open(address, link_opts) |> Link.stream("n", stream_opts)
    end)
  end

  test "a finished recording arrives completely and ends", %{root: root} do
    record(root, "lobby", 1..5_000)
    server = serve(Path.join(root, "lobby"))
    assert received(address(server), from: :start) == Enum.to_list(1..5_000)
    assert received(address(server), from: 4_990) == Enum.to_list(4_990..5_000)
    assert received(address(server), from: :now) == []
  end

  test "versions are one recording", %{root: root} do
    record(root, "lobby", 1..10)
    {writer, _} = record(root, "lobby", 11..20, open: true)
    :ok = Writer.close(writer)
    record(root, "lobby", 15..30)
    server = serve(Path.join(root, "lobby"))
    assert received(address(server), from: 5) == Enum.to_list(5..30)
    assert received(address(server), from: :start) == Enum.to_list(15..30)
  end

  test "follows a recording in progress while the server restarts", %{root: root} do
    recording = record(root, "lobby", 1..10, open: true)
    server = serve(Path.join(root, "lobby"))
    port = Server.port(server)
    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Link.open(address(server), from: :start)
        |> Link.stream("n")
        |> Situ.each(&send(me, {:got, &1}))
      end)

    for i <- 1..10, do: assert_receive({:got, ^i})
    Server.close(server)
    {writer, stream} = recording
    {:ok, stream} = Writer.append(stream, messages(11..20))
    refute_received {:got, _}
    server = serve(Path.join(root, "lobby"), port: port)
    for i <- 11..20, do: assert_receive({:got, ^i})
    {:ok, stream} = Writer.append(stream, messages(21..22))
    finish({writer, stream}, 22)
    for i <- 21..22, do: assert_receive({:got, ^i})
    assert {:ok, _} = Situ.Pipeline.await(pipeline)
    refute_received {:got, _}
    Server.close(server)
  end

  test "follows a recorder that restarts to the end", %{root: root} do
    _killed = record(root, "lobby", 1..10, open: true)
    {writer, stream} = record(root, "lobby", 11..20, open: true)
    server = serve(Path.join(root, "lobby"))
    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start_link(fn p ->
        p
        |> Link.open(address(server), from: 6)
        |> Link.stream("n")
        |> Situ.each(&send(me, {:got, &1}))
      end)

    for i <- 6..20, do: assert_receive({:got, ^i})
    finish({writer, stream}, 20)
    assert {:ok, _} = Situ.Pipeline.await(pipeline, 30_000)
  end
end
