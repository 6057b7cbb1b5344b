defmodule Situ.Bridge.ZeroMQ.Sink do
  @schema [
    socket: [type: {:in, [:pub, :push]}, required: true, doc: "Which socket."],
    address: [type: :string, required: true, doc: "tcp://HOST:PORT."],
    topic: [type: :string, default: "", doc: "The first frame of what is published."],
    format: [
      type: {:in, [:json, :csv, :message_pack, :raw]},
      default: :json,
      doc: "A format of `Situ.Bridge.Format`; `:raw`: data that are bytes, as they are."
    ],
    bind: [
      type: :boolean,
      default: true,
      doc: "Listen at the address instead of connecting to it."
    ],
    high_water_mark: [
      type: :pos_integer,
      default: 1_000,
      doc: "The most messages that wait for one peer."
    ],
    wait_for: [
      type: :non_neg_integer,
      default: 0,
      doc: "Send nothing before so many peers (subscribers) are there."
    ],
    linger: [
      type: :non_neg_integer,
      default: 1_000,
      doc: "How long to wait at the end for what is still to be sent, ms."
    ],
    listening: [
      type: {:optional, :pid},
      default: nil,
      doc: "Gets `{:listening, port}` once bound; of use with port 0."
    ]
  ]
  @moduledoc false
  # A stream to a ZeroMQ socket.
  use Situ.Component, inputs: [in: :any], options: @schema
  alias Situ.Bridge.Format
  alias Situ.Bridge.ZeroMQ.Socket

  def schema, do: @schema

  @impl true
  def init(opts),
    do: {:ok, %{opts: opts, socket: nil, waiting: opts[:wait_for] > 0, held: [], closing: false}}

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    most = 64 * 1024 * 1024

    case Socket.open(opts[:socket], opts[:address],
           bind: opts[:bind],
           high_water_mark: opts[:high_water_mark],
           most: most
         ) do
      {:ok, socket} ->
        if opts[:listening] && opts[:bind],
          do: send(opts[:listening], {:listening, Socket.port(socket)})

        {[], %{state | socket: socket}}

      {:error, error} ->
        raise error
    end
  end

  @impl true
  def handle_message(:in, message, _context, state),
    do: pour(%{state | held: state.held ++ [frames(message, state.opts)]})

  defp frames(message, opts) do
    payload = payload(message, opts[:format])
    if opts[:socket] == :pub, do: [opts[:topic], payload], else: [payload]
  end

  defp payload(%{data: bytes}, :raw) when is_binary(bytes), do: bytes
  defp payload(%{data: data}, :raw), do: raise(Format.not_writable(:raw, data))

  defp payload(message, format),
    do: Situ.Error.unwrap!(Format.encode(format, message.data, message.originating_time))

  @impl true
  def handle_info({:hold_ended, :in}, _context, state), do: pour(state)
  def handle_info(_other, _context, state), do: {[], state}

  # While nobody has room the stream waits.
  defp pour(%{waiting: true} = state) do
    if Socket.ready(state.socket) >= state.opts[:wait_for],
      do: pour(%{state | waiting: false}),
      else: {[{:hold, :in}], state}
  end

  defp pour(%{held: []} = state), do: {[{:resume, :in}], state}

  defp pour(%{held: [frames | rest]} = state) do
    case Socket.send_message(state.socket, state.opts[:topic], frames) do
      :ok -> pour(%{state | held: rest})
      :full -> {[{:hold, :in}], state}
    end
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    state = drain(state, System.monotonic_time(:millisecond) + state.opts[:linger])
    Socket.close(state.socket, state.opts[:linger])
    {[], %{state | socket: nil}}
  end

  # At the end there is nothing else to do than to wait.
  defp drain(state, until) do
    {_, state} = pour(state)

    if state.held != [] and System.monotonic_time(:millisecond) < until do
      receive do
      after
        5 -> drain(state, until)
      end
    else
      state
    end
  end

  @impl true
  def terminate(_reason, %{socket: nil}), do: :ok
  def terminate(_reason, state), do: Socket.close(state.socket, 0)

  @impl true
  def describe(%{socket: nil}), do: "closed"

  def describe(state),
    do: "#{Socket.ready(state.socket)} peers, #{Socket.dropped(state.socket)} messages dropped"
end
