defmodule Situ.Bridge.Recorder.Exporter do
  @moduledoc false
  # A file that a pipeline writes: one process has it, and a sink for every stream hands messages over.
  alias Situ.Bridge.Recorder.{Server, Sink}

  @enforce_keys [:server, :path, :writer]
  defstruct [:server, :path, :writer]
  @type t :: %__MODULE__{}

  @doc "`writer` is the module of the format (`Situ.Bridge.Recorder`)."
  def create(%Situ.Graph.Handle{} = p, writer, path, opts) do
    opts = Situ.Options.validate!(opts, writer.file_options())
    {:ok, server} = Server.start(p.pid, {writer, path, opts})
    %__MODULE__{server: server, path: path, writer: writer}
  end

  def write(stream, %__MODULE__{} = exporter, topic, opts) do
    {given, placement} = Keyword.split(opts, Keyword.keys(exporter.writer.topic_options()))
    Server.expect(exporter.server)

    Situ.via(
      stream,
      Sink,
      [
        server: exporter.server,
        topic: topic,
        given: given,
        name: "#{Path.basename(exporter.path)} #{topic}"
      ] ++ placement
    )

    stream
  end
end
