defmodule Situ.Bridge.Recorder.Exporter do
  @moduledoc false
  # Writes streams of a pipeline to one file: a server process owns the file, and a sink per stream sends it messages.
  alias Situ.Bridge.Recorder.{Server, Sink}

  @enforce_keys [:server, :path, :writer]
  defstruct [:server, :path, :writer]
  @type t :: %__MODULE__{}

  @doc "Creates an exporter; `writer` is the module of the format (`Situ.Bridge.Recorder`)."
  def create(%Situ.Graph.Handle{} = p, writer, path, opts) do
    opts = Situ.Options.validate!(opts, writer.file_options())
    {:ok, server} = Server.start(p.pid, {writer, path, opts})
    %__MODULE__{server: server, path: path, writer: writer}
  end

  def write(stream, %__MODULE__{} = exporter, topic, opts) do
    {topic_options, placement} =
      Keyword.split(opts, Keyword.keys(exporter.writer.topic_options()))

    Server.expect_stream(exporter.server)

    Situ.via(
      stream,
      Sink,
      [
        server: exporter.server,
        topic: topic,
        topic_options: topic_options,
        name: "#{Path.basename(exporter.path)} #{topic}"
      ] ++ placement
    )

    stream
  end
end
