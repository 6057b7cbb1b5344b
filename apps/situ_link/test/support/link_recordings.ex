defmodule Situ.Test.LinkRecordings do
  @moduledoc "Provides recordings, servers and links for tests."
  import ExUnit.Callbacks, only: [on_exit: 1]
  alias Situ.{Message, Link}
  alias Situ.Link.Server
  alias Situ.Store.Writer

  @doc "Creates a folder for the test."
  def folder do
    root = Path.join(System.tmp_dir!(), "situ-link-#{System.unique_integer([:positive])}")
    File.mkdir_p!(root)
    on_exit(fn -> File.rm_rf!(root) end)
    root
  end

  @doc "Returns messages whose data are their times; `data:` converts the data."
  def messages(times, data \\ & &1) do
    for t <- times,
        do: %Message{data: data.(t), originating_time: t, creation_time: t, sequence_id: t}
  end

  @doc "Begins a new, open version of recording `name` with these streams; returns `{writer, %{name => stream}}`."
  def begin(root, name, streams) do
    {:ok, writer} = Writer.create(name, root)

    streams =
      Map.new(streams, fn {stream, messages} ->
        {:ok, written} = Writer.stream(writer, stream)
        {:ok, written} = Writer.append(written, messages)
        {stream, written}
      end)

    {writer, streams}
  end

  @doc "Closes the recording that `begin/3` began."
  def finish({writer, streams}, time \\ 1_000_000) do
    for {_, stream} <- streams, do: {:ok, _} = Writer.close_stream(stream, time)
    :ok = Writer.close(writer)
  end

  @doc "Starts a server on a free port that ends with the test."
  def serve(what, opts \\ []) do
    {:ok, server} = Link.serve(what, Keyword.merge([port: 0], opts))
    on_exit(fn -> Server.close(server) end)
    server
  end

  @doc "Returns the address of a server."
  def address(server, name \\ "lobby"), do: "situ://127.0.0.1:#{Server.port(server)}/#{name}"

  @doc "Returns all data of a stream of a link."
  def received(address, name, link_opts \\ [from: :start], stream_opts \\ []) do
    Situ.to_list(fn p ->
      p |> Link.open(address, link_opts) |> Link.stream(name, stream_opts)
    end)
  end

  @doc "Waits until `condition` holds."
  @spec eventually((() -> boolean()), non_neg_integer()) :: term()
  def eventually(condition, left \\ 3_000) do
    unless condition.() do
      if left == 0, do: raise("it did not come true")
      Process.sleep(10)
      eventually(condition, left - 1)
    end
  end
end
