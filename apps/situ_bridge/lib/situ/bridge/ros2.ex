defmodule Situ.Bridge.Ros2 do
  @moduledoc """
  Live topics of ROS 2, as `rmw_zenoh` has them on Zenoh: no ROS is needed on this machine, but Zenoh's router
  (`rmw_zenohd`) somewhere, and the program `zenoh_port` (`bin/setup --with ros2` builds it; it is no part of the
  ordinary build).

      imu = Situ.Bridge.Ros2.subscribe(p, "/imu", router: "tcp/robot:7447")
      Situ.Bridge.Ros2.publish(pictures, "/camera/image_raw", frame: "camera")

  Standard messages are Situ's types (`Situ.Bridge.Ros.Standard`), others maps with string keys, by `definition:`. The
  stamp of a header becomes the originating time, or else the time at which the sender sent it. Each stream is a node of
  its own, seen by `ros2 topic list`. Types are told apart by ROS's own hash.

  A router that is not there yet is waited for, and one that was restarted is found again. A subscriber that is too slow
  loses messages beyond `high_water_mark:`; a publisher's stream waits for the network. Messages that cannot be read, or
  whose times do not increase, are left out and counted (`Situ.Pipeline.info/1`). Services, parameters and latched
  topics are not there yet.
  """
  alias Situ.Bridge.Ros2.{Sink, Source}

  @doc """
  Publishes a stream on a topic; returns the stream. Error of the pipeline: `:no_zenoh_port`.

  #{Situ.Options.docs(Keyword.delete(Sink.schema(), :topic))}
  """
  @spec publish(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def publish(stream, topic, opts \\ []) do
    Situ.via(stream, Sink, [topic: topic] ++ opts)
    stream
  end

  @doc """
  A source of a topic's messages. Error of the pipeline: `:no_zenoh_port`.

  #{Situ.Options.docs(Keyword.delete(Source.schema(), :topic))}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, topic, opts \\ []),
    do: Situ.source(p, Source, [topic: topic, outputs: [out: opts[:type] || :any]] ++ opts)

  @doc "The name that all bridges have for their way out: `publish/3`."
  @spec sink(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, topic, opts \\ []), do: publish(stream, topic, opts)

  @doc "The name that all bridges have for their way in: `subscribe/3`."
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, topic, opts \\ []), do: subscribe(p, topic, opts)
end
