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

  @max_bytes 64 * 1024 * 1024

  def schema, do: @schema

  @impl true
  def init(opts), do: {:ok, PeerSender.new(opts)}

  @impl true
  def handle_start(_context, sender) do
    if sender.opts[:shared], do: open_shared(sender), else: open_own(sender)
  end

  defp open_shared(%{opts: opts} = sender) do
    case SharedPublisher.open_stream(opts[:shared]) do
      {:ok, server, port} -> {[], PeerSender.attach_server(sender, SharedPublisher, server, port)}
      {:error, error} -> raise error
    end
  end

  defp open_own(%{opts: opts} = sender) do
    socket_opts = Keyword.take(opts, [:bind, :high_water_mark])

    case Socket.open(opts[:socket], opts[:address], [most: @max_bytes] ++ socket_opts) do
      {:ok, socket} ->
        port = if opts[:bind], do: Socket.port(socket)
        {[], PeerSender.attach_server(sender, Socket, socket, port)}

      {:error, error} ->
        raise error
    end
  end

  @impl true
  def handle_message(:in, message, _context, sender),
    do: PeerSender.send_payload(sender, build_frames(message, sender.opts))

  defp build_frames(message, opts) do
    payload = PeerSender.encode_payload(message, opts)
    if opts[:socket] == :pub, do: [opts[:topic], payload], else: [payload]
  end
end
