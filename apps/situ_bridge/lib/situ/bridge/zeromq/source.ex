defmodule Situ.Bridge.ZeroMQ.Source do
  alias Situ.Bridge.PayloadDecoder

  @schema [
            socket: [type: {:in, [:sub, :pull]}, required: true, doc: "The type of the socket."],
            address: [type: :string, required: true, doc: "The address, `tcp://HOST:PORT`."],
            topic: [type: :string, default: "", doc: "The topic to subscribe to."],
            prefix: [
              type: :boolean,
              default: false,
              doc: "Receive all topics that begin with `topic:`, not only that topic."
            ],
            bind: [
              type: :boolean,
              default: false,
              doc: "Listen on the address instead of connecting to it."
            ],
            high_water_mark: [
              type: :pos_integer,
              default: 1_000,
              doc: "The limit of messages received ahead of the component."
            ],
            most: [
              type: :pos_integer,
              default: 64 * 1024 * 1024,
              doc: "The maximum message size in bytes; a peer that sends more is disconnected."
            ],
            listening: [
              type: {:optional, :pid},
              default: nil,
              doc:
                "A process that receives `{:listening, port}` after binding; useful with port 0."
            ]
          ] ++ PayloadDecoder.options()
  @moduledoc false
  # A ZeroMQ socket as an endless source.
  use Situ.Component, outputs: [out: :any], options: @schema
  alias Situ.Bridge.ZeroMQ.Socket

  def schema, do: @schema

  @impl true
  def init(opts),
    do: {:ok, %{opts: opts, socket: nil, unread_counter: nil, decoder: PayloadDecoder.new(opts)}}

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    subscriptions = if opts[:socket] == :sub, do: [opts[:topic]], else: []
    socket_opts = Keyword.take(opts, [:bind, :high_water_mark, :most])

    case Socket.open(opts[:socket], opts[:address], [subscriptions: subscriptions] ++ socket_opts) do
      {:ok, socket} ->
        if opts[:listening] && opts[:bind],
          do: send(opts[:listening], {:listening, Socket.port(socket)})

        {[{:complete, :infinity}],
         %{state | socket: socket, unread_counter: Socket.unread_counter(socket)}}

      {:error, error} ->
        raise error
    end
  end

  @impl true
  def handle_info({:zeromq, messages}, context, state) do
    Socket.subtract_read(state.unread_counter, length(messages))
    payloads = Enum.flat_map(messages, &take_payload(&1, state.opts))
    {actions, decoder} = PayloadDecoder.take_payloads(state.decoder, payloads, context.now)
    {actions, %{state | decoder: decoder}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp take_payload([payload], opts), do: if(opts[:socket] == :pull, do: [payload], else: [])

  defp take_payload([topic, payload], opts) do
    cond do
      opts[:socket] == :pull -> [payload]
      topic == opts[:topic] or opts[:prefix] -> [payload]
      true -> []
    end
  end

  defp take_payload(_frames, _opts), do: [""]

  @impl true
  def handle_stop(_final_time, _context, state), do: {[], close_socket(state)}

  @impl true
  def terminate(_reason, state), do: close_socket(state)

  defp close_socket(%{socket: nil} = state), do: state

  defp close_socket(state) do
    Socket.close(state.socket, 0)
    %{state | socket: nil}
  end

  @impl true
  def describe(state), do: PayloadDecoder.describe_counts(state.decoder)
end
