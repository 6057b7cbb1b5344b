defmodule Situ.Bridge.ZeroMQ.Sink do
  alias Situ.Bridge.PeerSender
  alias Situ.Bridge.ZeroMQ.SharedPublisher

  @schema [
            socket: [type: {:in, [:pub, :push]}, required: true, doc: "The type of the socket."],
            address: [type: :string, default: "", doc: "The address, `tcp://HOST:PORT`."],
            shared: [
              type: {:optional, {:struct, SharedPublisher}},
              default: nil,
              doc: "A socket that several streams share."
            ],
            topic: [type: :string, default: "", doc: "The first frame of published messages."],
            bind: [
              type: :boolean,
              default: true,
              doc: "Listen on the address instead of connecting to it."
            ]
          ] ++ PeerSender.options()
  @moduledoc false
  # Sends a stream to a ZeroMQ socket.
  use Situ.Component, inputs: [in: :any], options: @schema
  use PeerSender
  alias Situ.Bridge.ZeroMQ.Socket

  @most 64 * 1024 * 1024

  def schema, do: @schema

  @impl true
  def init(opts), do: {:ok, PeerSender.new(opts)}

  @impl true
  def handle_start(_context, outlet) do
    if outlet.opts[:shared], do: open_shared(outlet), else: open_own(outlet)
  end

  defp open_shared(%{opts: opts} = outlet) do
    case SharedPublisher.open_stream(opts[:shared]) do
      {:ok, door, port} -> {[], PeerSender.attach_door(outlet, SharedPublisher, door, port)}
      {:error, error} -> raise error
    end
  end

  defp open_own(%{opts: opts} = outlet) do
    given = Keyword.take(opts, [:bind, :high_water_mark])

    case Socket.open(opts[:socket], opts[:address], [most: @most] ++ given) do
      {:ok, socket} ->
        port = if opts[:bind], do: Socket.port(socket)
        {[], PeerSender.attach_door(outlet, Socket, socket, port)}

      {:error, error} ->
        raise error
    end
  end

  @impl true
  def handle_message(:in, message, _context, outlet),
    do: PeerSender.send_payload(outlet, build_frames(message, outlet.opts))

  defp build_frames(message, opts) do
    payload = PeerSender.encode_payload(message, opts)
    if opts[:socket] == :pub, do: [opts[:topic], payload], else: [payload]
  end
end
