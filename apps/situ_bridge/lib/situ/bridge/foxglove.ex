defmodule Situ.Bridge.Foxglove do
  @moduledoc """
  Serves recordings to Foxglove and other programs that use its WebSocket protocol, even while they are being written.

      {:ok, server} = Situ.Bridge.Foxglove.serve("recordings/lobby")
      # In Foxglove: open a connection to ws://localhost:8765

  Each stream with messages becomes a channel. Images, point clouds, poses and other standard types are sent as ROS
  messages (the table in `Situ.Bridge.Ros`), all other types as JSON. Each client has its own playback, which starts
  immediately. The client pauses, seeks and changes the speed with the app's own controls (protocol `foxglove.sdk.v1`)
  or with the parameters `situ.paused`, `situ.speed` and `situ.position` (seconds; `foxglove.websocket.v1`). After
  subscribing and after each seek, a client first gets the message that is current at that position. If the recording
  is still being written, clients also get its new messages.

  A slow client slows down only its own playback. No messages are dropped, and at most a few megabytes are buffered
  for it. Foxglove requires a WebSocket subprotocol, which the web server of the studio does not support, so this
  server needs a separate port.

  ## Foxglove's messages

  MCAP files (`Situ.Bridge.Mcap`) and files of Protobuf messages (`Situ.Bridge.Protobuf.File`) may contain Foxglove's
  own messages, which become Situ's types. Messages without a Situ type (`Log`, `LaserScan`, `SceneUpdate` ...) become
  maps (`Situ.Bridge.Protobuf`).

  | Foxglove | Situ |
  |---|---|
  | `CompressedImage` (JPEG, PNG) | `Situ.EncodedImage` |
  | `RawImage` (`mono8`, `mono16`, `rgb8`, `bgr8`, `rgba8`, `bgra8`, `8UC1`, `8UC3`, `16UC1`) | `Situ.Image`; `16UC1` is a `Situ.DepthImage` in millimetres |
  | `CompressedVideo` (H.264, VP9) | export only, from images that are recorded as video (`Situ.VideoPacket`) |
  | `PointCloud` (x, y, z as float32; red, green, blue as uint8) | `Situ.PointCloud` |
  | `FrameTransform`, `FrameTransforms` | a `Situ.Transform`, or a list of them |
  | `Pose`, `PoseInFrame` | `Situ.Pose` |
  | `Point3`, `Vector3` | `Situ.Point3` |
  | `CameraCalibration` | `Situ.CameraIntrinsics` |
  | `LocationFix` | `Situ.GeoPoint` |
  | `JointStates` | `Situ.JointState` |
  | `RawAudio` (`pcm-s16`) | `Situ.AudioBuffer` |
  | `Log` | export only, from strings |
  """

  @schema [
    port: [
      type: {:integer, 0, 65_535},
      default: 8_765,
      doc: "The port; the default is Foxglove's. 0 selects any free port."
    ],
    interface: [
      type: :string,
      default: "127.0.0.1",
      doc: "The address to listen on; \"*\" means all interfaces."
    ],
    name: [type: :string, doc: "The server's name; by default the recording's name."],
    origins: [
      type: {:list, :string},
      default: ["https://app.foxglove.dev"],
      doc: "The sites whose pages may connect. Pages that this machine serves may always connect."
    ]
  ]

  # Foxglove closes a WebSocket if the server does not confirm the subprotocol. Yaws 2.1.1 (Debian
  # 12) reads the list of subprotocols but does not reply to it, and an application cannot add a
  # header to the handshake. Port 8765 is the default of the Foxglove app. The token of the studio
  # does not protect this port, so connections from pages of other sites are rejected by their
  # origin.
  use GenServer
  alias Situ.Bridge.Foxglove.Client
  alias Situ.Bridge.Net.Listener
  alias Situ.Error

  @max_clients 100

  @doc """
  Serves a recording to any number of clients until `stop/1`. Errors: the errors of `Situ.Store.open/2`,
  `:address_in_use`, `:bad_address`.

  #{Situ.Options.docs(@schema)}
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

  @doc "Returns the port that the server listens on."
  @spec port(pid()) :: :inet.port_number()
  def port(server), do: GenServer.call(server, :port)

  @doc "Stops the server."
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
    if MapSet.size(state.clients) >= @max_clients do
      {:reply, :full, state}
    else
      {:ok, client} = Client.start_link(state.args)
      {:reply, client, %{state | clients: MapSet.put(state.clients, client)}}
    end
  end

  @impl true
  def handle_info(:begin, state),
    do: {:noreply, %{state | acceptor: Listener.start_acceptor(state.listener, self())}}

  def handle_info({:EXIT, pid, reason}, %{acceptor: pid} = state), do: {:stop, reason, state}

  def handle_info({:EXIT, pid, reason}, state) do
    if pid in state.clients,
      do: {:noreply, %{state | clients: MapSet.delete(state.clients, pid)}},
      else: {:stop, reason, state}
  end

  # A normal exit of the server would not terminate the linked clients.
  @impl true
  def terminate(_reason, state) do
    for client <- state.clients, do: Process.exit(client, :shutdown)
    :gen_tcp.close(state.listener)
  end
end
