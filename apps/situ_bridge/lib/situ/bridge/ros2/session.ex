defmodule Situ.Bridge.Ros2.Session do
  @moduledoc false
  # A ROS 2 node for one end of a topic. It runs the program `zenoh_port`, which holds the Zenoh session, and restarts
  # the program if it ends. The owner receives each sample as `{:ros2, {key, attachment, payload}}`.
  # `unread_counter` counts the samples that the owner has not yet handled; samples beyond the high-water mark are
  # dropped.
  use GenServer, restart: :temporary
  require Logger
  alias Situ.Bridge.Net.Drain
  alias Situ.Bridge.PeerSender
  alias Situ.Bridge.Ros2.{Keys, Zenoh}
  alias Situ.Error
  @behaviour PeerSender

  @restart_ms 1_000
  @topic_id 1
  @node_id 2
  @token_id 3

  defstruct [:owner, :opts, :port, :gid, up?: false, unconfirmed: 0, sequence: 0, dropped: 0]

  @doc """
  Starts a session for the calling process. `opts`: `role`, `router`, `domain`, `node`, `topic`, `type` and `hash` (or
  `nil`), `depth` (for a latched topic, or `nil`), `high_water_mark` and, for a subscriber,
  `unread_counter`. Error: `:no_zenoh_port`.
  """
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, program} <- Zenoh.find_program(),
         do: GenServer.start_link(__MODULE__, {self(), [program: program] ++ opts})
  end

  @impl PeerSender
  def count_ready(session), do: GenServer.call(session, :ready)
  @impl PeerSender
  def count_dropped(session), do: GenServer.call(session, :dropped)
  @impl PeerSender
  def put(session, {time, payload}), do: GenServer.call(session, {:put, time, payload}, :infinity)
  @impl PeerSender
  defdelegate close(session, timeout), to: Drain

  @doc "Stops the session. Does nothing if it has already ended."
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
    {:ok, start_program(state)}
  end

  defp start_program(%{opts: opts} = state),
    do: %{state | port: Zenoh.open(opts[:program], opts[:router]), up?: false, unconfirmed: 0}

  @impl true
  def handle_call(:ready, _from, state), do: {:reply, if(state.up?, do: 1, else: 0), state}
  def handle_call(:dropped, _from, state), do: {:reply, state.dropped, state}

  def handle_call({:put, time, payload}, _from, %{opts: opts} = state) do
    if state.up? and state.unconfirmed < opts[:high_water_mark] do
      attachment = Keys.build_attachment(state.sequence + 1, time, state.gid)
      Zenoh.put(state.port, @topic_id, attachment, payload)
      {:reply, :ok, %{state | sequence: state.sequence + 1, unconfirmed: state.unconfirmed + 1}}
    else
      {:reply, :full, state}
    end
  end

  def handle_call({:drain, deadline}, from, state), do: drain_samples(from, deadline, state)

  defp drain_samples(from, deadline, state) do
    Drain.reply_when_drained(from, deadline, state.unconfirmed)
    {:noreply, state}
  end

  @impl true
  def handle_info({port, {:data, frame}}, %{port: port} = state),
    do: {:noreply, frame |> Zenoh.parse_frame() |> handle_frame(state)}

  def handle_info({port, {:exit_status, status}}, %{port: port} = state) do
    Logger.warning("zenoh_port ended with status #{status}; restarting it")
    Process.send_after(self(), :restart, @restart_ms)
    {:noreply, %{state | port: nil, up?: false}}
  end

  def handle_info(:restart, state), do: {:noreply, start_program(state)}
  def handle_info({:drain, from, deadline}, state), do: drain_samples(from, deadline, state)
  def handle_info({:EXIT, owner, reason}, %{owner: owner} = state), do: {:stop, reason, state}
  def handle_info(_other, state), do: {:noreply, state}

  # The session is open, so the node and its topic can be declared.
  defp handle_frame({:open, session}, %{opts: opts, port: port} = state) do
    {domain, topic, type, depth} = {opts[:domain], opts[:topic], opts[:type], opts[:depth]}
    key = Keys.topic_key(domain, topic, type, opts[:hash])
    Zenoh.declare_token(port, @node_id, Keys.node_token(domain, session, opts[:node]))

    if opts[:role] == :publisher,
      do: Zenoh.declare_publisher(port, @topic_id, key, depth),
      else: Zenoh.declare_subscriber(port, @topic_id, key, depth)

    if type do
      topic_info = {topic, type, opts[:hash], depth}

      Zenoh.declare_token(
        port,
        @token_id,
        Keys.endpoint_token(opts[:role], domain, session, opts[:node], topic_info)
      )
    end

    %{state | up?: true}
  end

  defp handle_frame({:sample, _id, key, attachment, payload}, state) do
    unread_counter = state.opts[:unread_counter]

    if :atomics.get(unread_counter, 1) < state.opts[:high_water_mark] do
      :atomics.add(unread_counter, 1, 1)
      send(state.owner, {:ros2, {key, attachment, payload}})
      state
    else
      %{state | dropped: state.dropped + 1}
    end
  end

  defp handle_frame({:put, _id}, state), do: %{state | unconfirmed: max(state.unconfirmed - 1, 0)}

  defp handle_frame({:trouble, _id, why}, state) do
    Logger.warning("Zenoh: #{why}")
    state
  end

  defp handle_frame(_other, state), do: state

  @impl true
  def terminate(_reason, state), do: Zenoh.close(state.port)
end
