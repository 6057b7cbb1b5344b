defmodule Situ.Bridge.Tcp.Sink do
  @schema [
    port: [type: {:range, 0, 65_535}, required: true, doc: "The port to listen on."],
    interface: [
      type: :string,
      default: "127.0.0.1",
      doc: "Where to listen; \"0.0.0.0\": everywhere."
    ],
    format: [
      type: {:in, [:json, :csv, :message_pack, :raw]},
      default: :json,
      doc: "A format of `Situ.Bridge.Format`; `:raw`: data that are bytes, as they are."
    ],
    high_water_mark: [
      type: :pos_integer,
      default: 1_000,
      doc: "The most messages that wait for one client."
    ],
    wait_for: [
      type: :non_neg_integer,
      default: 0,
      doc: "Send nothing before so many clients are there."
    ],
    linger: [
      type: :non_neg_integer,
      default: 1_000,
      doc: "How long to wait at the end for what is still to be sent, ms."
    ],
    listening: [
      type: {:optional, :pid},
      default: nil,
      doc: "Gets `{:listening, port}`; of use with port 0."
    ]
  ]
  @moduledoc false
  # A stream to whoever connects.
  use Situ.Component, inputs: [in: :any], options: @schema
  alias Situ.Bridge.Format
  alias Situ.Bridge.Tcp.{Frames, Server}

  def schema, do: @schema

  @impl true
  def init(opts), do: {:ok, %{opts: opts, server: nil, waiting: opts[:wait_for] > 0, held: []}}

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    case Server.open(opts[:interface], opts[:port], opts[:high_water_mark]) do
      {:ok, server} ->
        if opts[:listening], do: send(opts[:listening], {:listening, Server.port(server)})
        {[], %{state | server: server}}

      {:error, error} ->
        raise error
    end
  end

  @impl true
  def handle_message(:in, message, _context, state),
    do: pour(%{state | held: state.held ++ [Frames.write(payload(message, state.opts[:format]))]})

  defp payload(%{data: bytes}, :raw) when is_binary(bytes), do: bytes
  defp payload(%{data: data}, :raw), do: raise(Format.not_writable(:raw, data))

  defp payload(message, format),
    do: Situ.Error.unwrap!(Format.encode(format, message.data, message.originating_time))

  @impl true
  def handle_info({:hold_ended, :in}, _context, state), do: pour(state)
  def handle_info(_other, _context, state), do: {[], state}

  defp pour(%{waiting: true} = state) do
    if Server.clients(state.server) >= state.opts[:wait_for],
      do: pour(%{state | waiting: false}),
      else: {[{:hold, :in}], state}
  end

  defp pour(state) do
    for frame <- state.held, do: Server.send_frame(state.server, frame)
    {[{:resume, :in}], %{state | held: []}}
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    {_, state} = pour(%{state | waiting: false})
    Server.close(state.server, state.opts[:linger])
    {[], %{state | server: nil}}
  end

  @impl true
  def terminate(_reason, %{server: nil}), do: :ok
  def terminate(_reason, state), do: Server.close(state.server, 0)

  @impl true
  def describe(%{server: nil}), do: "closed"

  def describe(state),
    do:
      "#{Server.clients(state.server)} clients, #{Server.dropped(state.server)} messages dropped"
end
