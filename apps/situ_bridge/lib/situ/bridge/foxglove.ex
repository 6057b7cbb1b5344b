defmodule Situ.Bridge.Foxglove do
  @schema [
    port: [type: {:integer, 0, 65_535}, default: 8_765, doc: "Foxglove's own default; 0: any."],
    interface: [type: :string, default: "127.0.0.1", doc: "Where to listen; \"*\": everywhere."],
    name: [type: :string, doc: "The server's name; else the recording's."],
    origins: [
      type: {:list, :string},
      default: ["https://app.foxglove.dev"],
      doc: "Pages of these sites may connect; those of this machine always may."
    ]
  ]
  @moduledoc """
  Recordings for Foxglove and whatever else speaks its WebSocket protocol, also while they are written.

      {:ok, server} = Situ.Bridge.Foxglove.serve("recordings/lobby")
      # In Foxglove: open a connection to ws://localhost:8765

  Every stream with messages is a channel: pictures, clouds, poses and other standard things as ROS's messages
  (`Situ.Bridge.Ros.Standard`), all else as JSON. Each client has a playback of its own, which begins at once: it
  pauses, seeks and changes its speed by the app's own controls (protocol `foxglove.sdk.v1`) or by the parameters
  `situ.paused`, `situ.speed` and `situ.position` (seconds; `foxglove.websocket.v1`). A subscriber begins with the
  message that holds there, and so does every seek. Of a recording that is being written clients get what is new.

  A slow client slows down its own playback, and nothing else: nothing is left out, and no more than a few megabytes
  wait for it. The web server of the studio answers no subprotocol, which Foxglove asks for; therefore this has a port
  of its own.

  ## Options of `serve/2`

  #{Situ.Options.docs(@schema)}
  """
  use GenServer
  alias Situ.Bridge.Foxglove.Client
  alias Situ.Bridge.Net.Listener
  alias Situ.Error

  @most_clients 100

  @doc """
  Serves a recording to any number of clients until `stop/1`. Errors: as `Situ.Store.open/2`, `:address_in_use`,
  `:bad_address`.
  """
  @spec serve(Path.t() | Situ.Store.t(), keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def serve(store, opts \\ [])

  def serve(path, opts) when is_binary(path) do
    with {:ok, store} <- Situ.Store.open(path), do: serve(store, opts)
  end

  def serve(store, opts) do
    opts = Situ.Options.validate!(opts, @schema)

    with {:ok, listener} <- Listener.listen(opts[:interface], opts[:port]) do
      args = %{
        store: store,
        name: opts[:name] || Situ.Store.info(store).name,
        origins: opts[:origins]
      }

      {:ok, server} = GenServer.start_link(__MODULE__, {listener, args})
      :ok = :gen_tcp.controlling_process(listener, server)
      send(server, :begin)
      {:ok, server}
    end
  end

  @doc "The port that it listens on."
  @spec port(pid()) :: :inet.port_number()
  def port(server), do: GenServer.call(server, :port)

  @spec stop(pid()) :: :ok
  def stop(server), do: GenServer.stop(server)

  @impl true
  def init({listener, args}) do
    Process.flag(:trap_exit, true)
    {:ok, %{listener: listener, args: args, acceptor: nil, clients: MapSet.new()}}
  end

  @impl true
  def handle_call(:port, _from, state), do: {:reply, Listener.port(state.listener), state}

  def handle_call(:adopt, _from, state) do
    if MapSet.size(state.clients) >= @most_clients do
      {:reply, :full, state}
    else
      {:ok, client} = Client.start_link(state.args)
      {:reply, client, %{state | clients: MapSet.put(state.clients, client)}}
    end
  end

  @impl true
  def handle_info(:begin, state),
    do: {:noreply, %{state | acceptor: Listener.begin(state.listener, self())}}

  def handle_info({:EXIT, pid, reason}, %{acceptor: pid} = state), do: {:stop, reason, state}

  def handle_info({:EXIT, pid, reason}, state) do
    if pid in state.clients,
      do: {:noreply, %{state | clients: MapSet.delete(state.clients, pid)}},
      else: {:stop, reason, state}
  end

  # Links would not take them along when it ends well.
  @impl true
  def terminate(_reason, state) do
    for client <- state.clients, do: Process.exit(client, :shutdown)
    :gen_tcp.close(state.listener)
  end
end
