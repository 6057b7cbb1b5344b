defmodule Situ.Media do
  @moduledoc """
  Images and audio from files, devices and the network.

      def build(p, opts) do
        clip = Situ.Media.open(p, opts[:source])          # "talk1.mp4", "/dev/video0", "rtsp://...", "simulated:talk1.mp4"
        clip.video |> Situ.each(&IO.inspect/1)
      end

  | to read | | to write | |
  |---|---|---|---|
  | `Situ.Media.VideoFile` | any media file | `Situ.Media.VideoWriter` | MP4, MKV, WebM ... |
  | `Situ.Media.WavFile` | WAV | `Situ.Media.WavWriter` | WAV |
  | `Situ.Media.ImageSequence` | JPEG, PNG files | `Situ.Media.ImageSequenceWriter` | JPEG, PNG files |
  | `Situ.Media.Camera`, `Situ.Media.Microphone` | devices | `Situ.Media.Speaker` | devices |
  | `Situ.Media.LiveStream` | the network, simulated devices | | |

  The guide "Files and devices" has examples.
  """
  alias Situ.Media.{Camera, Device, LiveStream, Microphone, VideoFile}

  @doc """
  Opens a source of images and audio by name, so that a pipeline can be tested with a file and run with a camera.

    * a file: `Situ.Media.VideoFile` (at the file's own times);
    * a URL or a simulated device: `Situ.Media.LiveStream`;
    * a camera: `Situ.Media.Camera`, with the microphone `microphone:` (default `\"pulse:default\"`, `nil` for none).

  `size:` and `format:` apply to the images, `audio_format:` and `audio_buffer:` to the audio. Returns
  `%{video: stream | nil, audio: stream | nil}`. Raises `Situ.Error` if the source does not exist.
  """
  @spec open(Situ.Pipeline.t(), String.t(), keyword()) :: %{
          video: Situ.Stream.t() | nil,
          audio: Situ.Stream.t() | nil
        }
  def open(p, source, opts \\ []) when is_binary(source) do
    {microphone, opts} = Keyword.pop(opts, :microphone, "pulse:default")

    # A file may have any name, so an existing file takes precedence.
    if File.exists?(source) and not String.starts_with?(source, "/dev/"),
      do: VideoFile.open(p, source, opts),
      else: open_device(p, source, microphone, opts)
  end

  defp open_device(p, source, microphone, opts) do
    case Device.parse_name(source) do
      {:ok, {driver, _}} when driver in [Device.V4L2, Device.Input] ->
        {sound, pictures} = Keyword.split(opts, [:audio_format, :audio_buffer])
        video = Camera.open(p, [device: source] ++ pictures)
        audio = microphone && Microphone.open(p, [device: microphone] ++ sound)
        %{video: video, audio: audio}

      {:ok, _} ->
        Map.merge(%{video: nil, audio: nil}, LiveStream.open(p, [device: source] ++ opts))

      {:error, _} ->
        # The name is neither a device nor an existing file. The error about the file is more helpful.
        VideoFile.open(p, source, opts)
    end
  end
end
