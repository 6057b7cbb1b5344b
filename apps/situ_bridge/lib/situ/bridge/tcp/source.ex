defmodule Situ.Bridge.Tcp.Source do
  alias Situ.Bridge.Inlet

  @schema [
            host: [type: :string, required: true, doc: "Where the server is."],
            port: [type: {:range, 1, 65_535}, required: true, doc: "Its port."],
            most: [
              type: :pos_integer,
              default: 64 * 1024 * 1024,
              doc: "The largest message, bytes; a server that sends a larger one is left."
            ]
          ] ++ Inlet.options()
  @moduledoc false
  # A connection to a server as a source that never ends. It lives in the component's own process: nothing is read
  # while the component is busy, so that the other side waits or drops.
  use Situ.Component, outputs: [out: :any], options: @schema
  alias Situ.Bridge.Tcp.Frames
  require Logger

  @first_wait 50
  @longest_wait 5_000

  def schema, do: @schema

  @impl true
  def init(opts) do
    state = %{opts: opts, tcp: nil, buffer: "", wait: @first_wait, told: nil, open: true}
    {:ok, Map.put(state, :inlet, Inlet.new(opts))}
  end

  @impl true
  def handle_start(_context, state) do
    send(self(), :connect)
    {[{:complete, :infinity}], state}
  end

  @impl true
  def handle_info(:connect, _context, %{open: true, tcp: nil} = state) do
    host = String.to_charlist(state.opts[:host])

    case :gen_tcp.connect(host, state.opts[:port], [:binary, active: :once, nodelay: true], 2_000) do
      {:ok, tcp} -> {[], %{state | tcp: tcp, wait: @first_wait, told: nil}}
      {:error, reason} -> {[], again(state, reason)}
    end
  end

  def handle_info({:tcp, tcp, bytes}, context, %{tcp: tcp} = state) do
    case Frames.read(state.buffer <> bytes, state.opts[:most]) do
      {:ok, payloads, rest} ->
        {actions, inlet} = Inlet.take(state.inlet, payloads, context.now)
        :inet.setopts(tcp, active: :once)
        {actions, %{state | buffer: rest, inlet: inlet}}

      {:error, why} ->
        :gen_tcp.close(tcp)
        {[], again(state, why)}
    end
  end

  def handle_info({:tcp_closed, tcp}, _context, %{tcp: tcp} = state),
    do: {[], again(state, :closed)}

  def handle_info({:tcp_error, tcp, reason}, _context, %{tcp: tcp} = state),
    do: {[], again(state, reason)}

  def handle_info(_other, _context, state), do: {[], state}

  # The same trouble is told once, not at every attempt. A message that was cut off is lost.
  defp again(state, reason) do
    where = "#{state.opts[:host]}:#{state.opts[:port]}"

    if state.told != reason and reason != :closed,
      do: Logger.warning("TCP #{where}: #{inspect(reason)}")

    Process.send_after(self(), :connect, state.wait)
    wait = min(state.wait * 2, @longest_wait)
    %{state | tcp: nil, buffer: "", told: reason, wait: wait}
  end

  @impl true
  def handle_stop(_final_time, _context, state), do: {[], close(state)}

  @impl true
  def terminate(_reason, state), do: close(state)

  defp close(state) do
    if state.tcp, do: :gen_tcp.close(state.tcp)
    %{state | tcp: nil, open: false}
  end

  @impl true
  def describe(state), do: Inlet.describe(state.inlet)
end
