defmodule Situ.Cluster.Recordings do
  @moduledoc false
  # Lists the recordings on a cluster's nodes, and opens them from any node. When a recording is requested, its node
  # serves it over a link on the address in the node's name, with TLS if other machines can reach it. The token of
  # the link is random and is only sent over Erlang's distribution. Anybody who can call functions on the node can
  # therefore read its recordings.
  use GenServer
  alias Situ.{Error, Link, Store}

  # The limit applies to each node and keeps its newest recordings.
  @max_recordings 200
  @call_ms 5_000
  @serve_ms 15_000

  @typedoc "`id` is `NODE/NAME`; `live?` is true during the recording; `changed` is seconds since 1970."
  @type entry :: %{
          id: String.t(),
          node: node(),
          name: String.t(),
          live?: boolean(),
          changed: integer()
        }

  @spec start_link(Path.t() | nil) :: GenServer.on_start()
  def start_link(folder), do: GenServer.start_link(__MODULE__, folder, name: __MODULE__)

  @doc "Returns the recordings of all `nodes`, newest first on each node. Skips nodes that do not reply in time."
  @spec list_all([node()]) :: [entry()]
  def list_all(nodes \\ [node() | Node.list()]) do
    answers = :erpc.multicall(nodes, __MODULE__, :here, [], @call_ms)
    for {:ok, entries} <- answers, entry <- entries, do: entry
  end

  @doc "Returns the newest 200 recordings of this node."
  @spec here() :: [entry()]
  def here do
    with pid when is_pid(pid) <- Process.whereis(__MODULE__),
         folder when is_binary(folder) <- GenServer.call(pid, :folder, @call_ms) do
      entries = for path <- Store.list(folder), do: describe_recording(path)
      entries |> Enum.sort_by(&{-&1.changed, &1.name}) |> Enum.take(@max_recordings)
    else
      _ -> []
    end
  end

  defp describe_recording(path) do
    name = Path.basename(path)
    # The path of a recording in segments is not a folder.
    folder = Situ.Store.Folder.resolve_store(path) || path
    changed = with {:ok, %{mtime: at}} <- File.stat(folder, time: :posix), do: at, else: (_ -> 0)
    live? = with {:ok, store} <- Store.open(path), do: Store.live?(store), else: (_ -> false)
    %{id: "#{node()}/#{name}", node: node(), name: name, live?: live?, changed: changed}
  end

  @doc """
  Returns the address at which a recording can be opened now, and the options for its reader. Errors: `:not_found`,
  `:unreachable`, and the errors of `Situ.Link.serve/2`.
  """
  @spec fetch_address(String.t()) :: {:ok, String.t(), keyword()} | {:error, Error.t()}
  def fetch_address(id) do
    with [name, recording] <- String.split(id, "/", parts: 2),
         node when node != nil <-
           Enum.find([node() | Node.list()], &(Atom.to_string(&1) == name)) do
      request_serving(node, recording)
    else
      _ -> {:error, not_found_error(id)}
    end
  end

  defp request_serving(node, recording) do
    GenServer.call({__MODULE__, node}, {:serve, recording}, @serve_ms)
  catch
    :exit, reason ->
      {:error,
       Error.new(:unreachable, "#{node} is not responding: #{inspect(reason, limit: 5)}",
         fix: "check whether it is still a member of the cluster, then open the recording again"
       )}
  end

  defp not_found_error(id) do
    Error.new(:not_found, "no node of the cluster has a recording #{inspect(id)}",
      fix: "choose one from the list on the cluster page"
    )
  end

  @impl true
  def init(folder) do
    Process.flag(:trap_exit, true)
    {:ok, %{folder: folder && Path.expand(folder), servers: %{}}}
  end

  @impl true
  def handle_call(:folder, _from, state), do: {:reply, state.folder, state}

  def handle_call({:serve, name}, _from, %{servers: servers} = state)
      when is_map_key(servers, name) do
    {_server, address, opts} = servers[name]
    {:reply, {:ok, address, opts}, state}
  end

  def handle_call({:serve, name}, _from, state) do
    case serve_recording(state.folder, name) do
      {:ok, server, address, opts} ->
        {:reply, {:ok, address, opts}, put_in(state.servers[name], {server, address, opts})}

      {:error, error} ->
        {:reply, {:error, error}, state}
    end
  end

  @impl true
  def handle_info({:EXIT, server, _reason}, state) do
    servers = Map.reject(state.servers, fn {_, {pid, _, _}} -> pid == server end)
    {:noreply, %{state | servers: servers}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  # Only recordings in the list can be served, since a name must not be used as a path.
  defp serve_recording(folder, name) do
    with true <- is_binary(folder),
         path when path != nil <- Enum.find(Store.list(folder), &(Path.basename(&1) == name)),
         {:ok, store} <- Store.open(path) do
      token = Base.url_encode64(:crypto.strong_rand_bytes(18))
      host = node_host()
      tls = if host == "127.0.0.1", do: nil, else: true

      with {:ok, server} <-
             Link.serve(%{name => store}, port: 0, interface: host, tls: tls, token: token),
           do: {:ok, server, Link.Server.address(server, name), token: token}
    else
      {:error, error} -> {:error, error}
      _ -> {:error, not_found_error("#{node()}/#{name}")}
    end
  end

  # Returns the host in the node's name. A node without a name cannot be connected to other nodes.
  defp node_host do
    case node() |> Atom.to_string() |> String.split("@") do
      [_, host] when host not in ["nohost", "localhost"] -> host
      _ -> "127.0.0.1"
    end
  end
end
