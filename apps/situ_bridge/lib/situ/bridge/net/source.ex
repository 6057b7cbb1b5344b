defmodule Situ.Bridge.Net.Source do
  alias Situ.Bridge.PayloadDecoder
  alias Situ.Bridge.Net.{ClientSocket, KeepAlive, ReceiveBuffer}

  @schema [
            host: [type: :string, required: true, doc: "The host of the server."],
            port: [type: {:integer, 1, 65_535}, required: true, doc: "The port of the server."],
            protocol: [type: :any, required: true, doc: "The protocol, `{module, arg}`."],
            most: [
              type: :pos_integer,
              default: 64 * 1024 * 1024,
              doc: "The maximum message size in bytes; a server that sends more is disconnected."
            ]
          ] ++ ClientSocket.tls_options() ++ PayloadDecoder.options()
  @moduledoc false
  # A connection to a server as an endless source. The component's process owns the socket and reads nothing while the
  # component is busy, so the server waits or drops messages.
  use Situ.Component, outputs: [out: :any], options: @schema
  require Logger

  @min_wait_ms 50
  @max_wait_ms 5_000

  def schema, do: @schema

  @doc "Adds a source of the messages that a server sends with a protocol."
  def connect(p, protocol, host, port, opts) do
    opts =
      [protocol: protocol, host: host, port: port, outputs: [out: opts[:type] || :any]] ++ opts

    Situ.source(p, __MODULE__, opts)
  end

  @doc "Returns the documentation of the options for users."
  def option_docs,
    do: @schema |> Keyword.drop([:host, :port, :protocol, :tls]) |> Situ.Options.docs()

  @impl true
  def init(opts) do
    {:ok,
     %{
       opts: opts,
       tcp: nil,
       keep_alive: nil,
       protocol_state: nil,
       receive_buffer: %ReceiveBuffer{},
       decoder: PayloadDecoder.new(opts),
       wait_ms: @min_wait_ms,
       logged_error: nil,
       open?: true
     }}
  end

  @impl true
  def handle_start(_context, state) do
    send(self(), :connect)
    {[{:complete, :infinity}], state}
  end

  @impl true
  def handle_info(:connect, _context, %{open?: true, tcp: nil, opts: opts} = state) do
    {hello, protocol_state} = greet_server(opts, state.protocol_state)

    with {:ok, tcp} <- open_connection(opts),
         :ok <- send_hello(tcp, hello) do
      state = %{state | tcp: tcp, protocol_state: protocol_state}
      {[], keep_alive(%{state | receive_buffer: %ReceiveBuffer{}})}
    else
      {:error, reason} -> {[], schedule_reconnect(state, reason)}
    end
  end

  def handle_info(message, context, state) do
    case ClientSocket.match_message(message, state.tcp) do
      {:ok, bytes} ->
        handle_bytes(bytes, context, %{state | keep_alive: KeepAlive.note_bytes(state.keep_alive)})

      {:disconnected, reason} ->
        {[], schedule_reconnect(state, reason)}

      :other ->
        {[], check_peer(message, state)}
    end
  end

  defp check_peer(message, state) do
    case KeepAlive.handle_info(message, state.keep_alive) do
      {:ok, keep_alive} ->
        %{state | keep_alive: keep_alive}

      {:silent, why} ->
        ClientSocket.close(state.tcp)
        schedule_reconnect(state, why)

      :other ->
        state
    end
  end

  # A server may set another interval while it is connected.
  defp keep_alive(%{tcp: tcp, keep_alive: current, protocol_state: protocol_state} = state) do
    {module, _arg} = state.opts[:protocol]

    {interval_ms, ping} =
      if function_exported?(module, :keep_alive, 1),
        do: module.keep_alive(protocol_state),
        else: {0, ""}

    if interval_ms == if(current, do: current.interval_ms, else: 0) do
      state
    else
      KeepAlive.stop(current)
      %{state | keep_alive: KeepAlive.start_link(tcp, interval_ms, ping)}
    end
  end

  # Only a protocol with sessions uses the state of the previous connection.
  defp greet_server(opts, previous) do
    {module, arg} = opts[:protocol]

    if previous != nil and function_exported?(module, :resume, 3),
      do: module.resume(opts[:host], opts[:port], previous),
      else: module.hello(opts[:host], opts[:port], arg)
  end

  defp handle_bytes(bytes, context, %{opts: opts} = state) do
    case ReceiveBuffer.add_bytes(
           state.receive_buffer,
           bytes,
           missing_bytes(elem(opts[:protocol], 0), state.protocol_state)
         ) do
      {:ok, bytes, receive_buffer} ->
        read_payloads(bytes, context, %{state | receive_buffer: receive_buffer})

      {:more, receive_buffer} ->
        ClientSocket.activate_once(state.tcp)
        {[], %{state | receive_buffer: receive_buffer}}
    end
  end

  defp missing_bytes(module, protocol_state),
    do:
      if(function_exported?(module, :missing_bytes, 1),
        do: module.missing_bytes(protocol_state),
        else: 1
      )

  defp read_payloads(bytes, context, %{tcp: tcp, opts: opts} = state) do
    case elem(opts[:protocol], 0).read(bytes, state.protocol_state, opts[:most]) do
      {:ok, payloads, reply, protocol_state} ->
        {actions, decoder} = PayloadDecoder.take_payloads(state.decoder, payloads, context.now)
        if reply != "", do: ClientSocket.send_bytes(tcp, reply)
        ClientSocket.activate_once(tcp)

        state = keep_alive(%{state | protocol_state: protocol_state, decoder: decoder})
        {actions, reset_backoff(state, payloads)}

      {:error, why} ->
        ClientSocket.close(tcp)
        {[], schedule_reconnect(state, why)}

      {:reconnect, why, protocol_state} ->
        ClientSocket.close(tcp)
        {[], schedule_reconnect(%{state | protocol_state: protocol_state}, why)}
    end
  end

  defp open_connection(opts) do
    options = [nodelay: true, buffer: ReceiveBuffer.buffer_size()]
    ClientSocket.connect(opts[:host], opts[:port], opts[:tls], options)
  end

  defp send_hello(_tcp, ""), do: :ok

  defp send_hello(tcp, hello) do
    with {:error, _} = error <- ClientSocket.send_bytes(tcp, hello) do
      ClientSocket.close(tcp)
      error
    end
  end

  # After a readable message the server is known to work, so the next reconnect starts with the shortest wait.
  defp reset_backoff(state, payloads) do
    if payloads != [] or progress?(elem(state.opts[:protocol], 0), state.protocol_state),
      do: %{state | wait_ms: @min_wait_ms, logged_error: nil},
      else: state
  end

  defp progress?(module, protocol_state),
    do: function_exported?(module, :progress?, 1) and module.progress?(protocol_state)

  # A repeated error is logged once, not at every attempt. A partially received message is lost.
  defp schedule_reconnect(state, reason) do
    if state.logged_error != reason and reason != :closed,
      do:
        Logger.warning(
          "#{state.opts[:host]}:#{state.opts[:port]}: #{ClientSocket.describe_reason(reason)}"
        )

    KeepAlive.stop(state.keep_alive)
    Process.send_after(self(), :connect, state.wait_ms)
    state = %{state | tcp: nil, keep_alive: nil}
    %{state | logged_error: reason, wait_ms: min(state.wait_ms * 2, @max_wait_ms)}
  end

  @impl true
  def handle_stop(_final_time, _context, state), do: {[], close_connection(state)}

  @impl true
  def terminate(_reason, state), do: close_connection(state)

  defp close_connection(state) do
    KeepAlive.stop(state.keep_alive)
    if state.tcp, do: say_goodbye(state)
    %{state | tcp: nil, keep_alive: nil, open?: false}
  end

  defp say_goodbye(%{tcp: tcp, opts: opts} = state) do
    {module, _arg} = opts[:protocol]

    if function_exported?(module, :goodbye, 1),
      do: ClientSocket.send_bytes(tcp, module.goodbye(state.protocol_state))

    ClientSocket.close(tcp)
  end

  @impl true
  def describe(state), do: PayloadDecoder.describe_counts(state.decoder)
end
