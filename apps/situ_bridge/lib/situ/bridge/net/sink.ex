defmodule Situ.Bridge.Net.Sink do
  alias Situ.Bridge.PeerSender

  @schema [
            port: [type: {:integer, 0, 65_535}, required: true, doc: "The port to listen on."],
            protocol: [type: :any, required: true, doc: "The protocol, `{module, arg}`."],
            interface: [
              type: :string,
              default: "127.0.0.1",
              doc: "The interface to listen on; \"*\" means all interfaces."
            ]
          ] ++ PeerSender.options()
  @moduledoc false
  # Sends a stream to every client that connects.
  use Situ.Component, inputs: [in: :any], options: @schema
  use PeerSender
  alias Situ.Bridge.Net.Server

  def schema, do: @schema

  @doc "Serves a stream with a protocol; returns the stream."
  def serve_stream(stream, protocol, port, opts) do
    Situ.via(stream, __MODULE__, [protocol: protocol, port: port] ++ opts)
    stream
  end

  @doc "Returns the documentation of the options for users."
  def option_docs, do: @schema |> Keyword.drop([:port, :protocol]) |> Situ.Options.docs()

  @impl true
  def init(opts), do: {:ok, PeerSender.new(opts)}

  @impl true
  def handle_start(_context, %{opts: opts} = sender) do
    case Server.open(opts[:interface], opts[:port], opts[:high_water_mark], opts[:protocol]) do
      {:ok, server} -> {[], PeerSender.attach_server(sender, Server, server, Server.port(server))}
      {:error, error} -> raise error
    end
  end

  @impl true
  def handle_message(:in, message, _context, sender),
    do: PeerSender.send_payload(sender, PeerSender.encode_payload(message, sender.opts))
end
