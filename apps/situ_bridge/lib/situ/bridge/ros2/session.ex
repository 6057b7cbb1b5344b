defmodule Situ.Bridge.Ros2.Session do
  @moduledoc false
  # One end of a topic as a node of ROS 2: the program `zenoh_port` beside, which has the Zenoh session. Should it end,
  # it is started again. Samples go to the owner, as `{:ros2, [{key, attachment, payload}]}`, counted by `untaken`:
  # beyond the high-water mark samples are left out.
  use GenServer, restart: :temporary
  require Logger
  alias Situ.Bridge.Net.Linger
  alias Situ.Bridge.Outlet
  alias Situ.Bridge.Ros2.Keys
  alias Situ.Error
  @behaviour Outlet

  @again 1_000
  @id <<1::32>>

  defstruct [
    :owner,
    :opts,
    :port,
    :gid,
    up?: false,
    on_way: 0,
    sequence: 0,
    waiting: [],
    dropped: 0
  ]

  @doc """
  Starts it for the calling process. `opts`: `role`, `router`, `domain`, `node`, `topic`, `type` and `hash` (or `nil`),
  `high_water_mark` and, of a subscriber, `untaken`. Error: `:no_zenoh_port`.
  """
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, program} <- program(),
         do: GenServer.start_link(__MODULE__, {self(), [program: program] ++ opts})
  end

  @doc "Where the program is. Error: `:no_zenoh_port`."
  @spec program() :: {:ok, Path.t()} | {:error, Error.t()}
  def program do
    built = Path.join([:code.priv_dir(:situ_bridge), "zenoh", "zenoh_port"])
    path = System.get_env("SITU_ZENOH_PORT") || built

    if File.regular?(path) do
      {:ok, path}
    else
      {:error,
       Error.new(:no_zenoh_port, "live topics of ROS 2 need the program zenoh_port",
         why: "#{path} is not there",
         fix: "run bin/setup --with ros2 (minutes), or set SITU_ZENOH_PORT to it"
       )}
    end
  end

  @impl Outlet
  def ready(session), do: GenServer.call(session, :ready)
  @impl Outlet
  def dropped(session), do: GenServer.call(session, :dropped)
  @impl Outlet
  def put(session, {time, payload}), do: GenServer.call(session, {:put, time, payload}, :infinity)
  @impl Outlet
  defdelegate close(session, timeout), to: Linger

  @doc "Ends it."
  @spec stop(pid()) :: :ok
  def stop(session) do
    GenServer.stop(session, :normal, 10_000)
  catch
    :exit, _ -> :ok
  end

  @impl true
  def init({owner, opts}) do
    Process.flag(:trap_exit, true)
    state = %__MODULE__{owner: owner, opts: opts, gid: :crypto.strong_rand_bytes(16)}
    {:ok, begin(state)}
  end

  defp begin(%{opts: opts} = state) do
    args = ["client", "connect=" <> opts[:router]]
    options = [:binary, :exit_status, packet: 4, args: args]

    %{
      state
      | port: Port.open({:spawn_executable, opts[:program]}, options),
        up?: false,
        on_way: 0
    }
  end

  @impl true
  def handle_call(:ready, _from, state), do: {:reply, if(state.up?, do: 1, else: 0), state}
  def handle_call(:dropped, _from, state), do: {:reply, state.dropped, state}

  def handle_call({:put, time, payload}, _from, %{opts: opts} = state) do
    if state.up? and state.on_way < opts[:high_water_mark] do
      attachment = Keys.attachment(state.sequence + 1, time, state.gid)
      tell(state, [2, @id, <<byte_size(attachment)::16>>, attachment, payload])
      {:reply, :ok, %{state | sequence: state.sequence + 1, on_way: state.on_way + 1}}
    else
      {:reply, :full, state}
    end
  end

  def handle_call({:drain, until}, from, state), do: drain(from, until, state)

  defp drain(from, until, state) do
    Linger.drain(from, until, state.on_way > 0)
    {:noreply, state}
  end

  defp tell(state, frame), do: Port.command(state.port, frame)

  @impl true
  def handle_info({port, {:data, <<kind, rest::binary>>}}, %{port: port} = state),
    do: {:noreply, heard(kind, rest, state)}

  def handle_info({port, {:exit_status, status}}, %{port: port} = state) do
    Logger.warning("zenoh_port ended with status #{status}; it is started again")
    Process.send_after(self(), :again, @again)
    {:noreply, %{state | port: nil, up?: false}}
  end

  def handle_info(:again, state), do: {:noreply, begin(state)}
  def handle_info({:drain, from, until}, state), do: drain(from, until, state)
  def handle_info({:EXIT, owner, reason}, %{owner: owner} = state), do: {:stop, reason, state}
  def handle_info(_other, state), do: {:noreply, state}

  # It is open: now it is told what to do.
  defp heard(1, session, %{opts: opts} = state) do
    {domain, topic, type} = {opts[:domain], opts[:topic], opts[:type]}
    key = Keys.topic(domain, topic, type, opts[:hash])
    tell(state, [4, <<2::32>>, Keys.node(domain, session, opts[:node])])
    tell(state, [if(opts[:role] == :publisher, do: 1, else: 3), @id, key])

    if type do
      about = {topic, type, opts[:hash]}
      tell(state, [4, <<3::32>>, Keys.token(opts[:role], domain, session, opts[:node], about)])
    end

    %{state | up?: true}
  end

  defp heard(
         2,
         <<_id::32, n::16, key::binary-size(n), m::16, attachment::binary-size(m),
           payload::binary>>,
         state
       ) do
    untaken = state.opts[:untaken]

    if :atomics.get(untaken, 1) < state.opts[:high_water_mark] do
      :atomics.add(untaken, 1, 1)
      send(state.owner, {:ros2, {key, attachment, payload}})
      state
    else
      %{state | dropped: state.dropped + 1}
    end
  end

  defp heard(4, _id, state), do: %{state | on_way: max(state.on_way - 1, 0)}

  defp heard(255, <<_id::32, why::binary>>, state) do
    Logger.warning("Zenoh: #{why}")
    state
  end

  defp heard(_kind, _rest, state), do: state

  # With its standard input the program ends.
  @impl true
  def terminate(_reason, %{port: nil}), do: :ok
  def terminate(_reason, %{port: port}), do: if(Port.info(port), do: Port.close(port))
end
