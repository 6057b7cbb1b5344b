defmodule Situ.Media do
  @moduledoc """
  Pictures and sound, wherever they come from.

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

  The guide "Files and devices" shows them at work.
  """
  alias Situ.Media.{Camera, Device, LiveStream, Microphone, VideoFile}

  @doc """
  Opens a source of pictures and sound by its name, so that a pipeline can be tried with a file and run with a camera.

    * a file: `Situ.Media.VideoFile` (at the file's own times);
    * a URL, a simulated device: `Situ.Media.LiveStream`;
    * a camera: `Situ.Media.Camera`, with the microphone `microphone:` (default `\"pulse:default\"`, `nil` for none).

  `size:` and `format:` are those of the pictures, `audio_format:` and `audio_buffer:` those of the sound. Returns
  `%{video: stream | nil, audio: stream | nil}`; raises `Situ.Error` when there is no such source.
  """
  @spec open(Situ.Pipeline.t(), String.t(), keyword()) :: %{
          video: Situ.Stream.t() | nil,
          audio: Situ.Stream.t() | nil
        }
  def open(p, source, opts \\ []) when is_binary(source) do
    {microphone, opts} = Keyword.pop(opts, :microphone, "pulse:default")

    # A file may have any name; one that is there is what is meant.
    if File.exists?(source) and not String.starts_with?(source, "/dev/"),
      do: VideoFile.open(p, source, opts),
      else: device(p, source, microphone, opts)
  end

  defp device(p, source, microphone, opts) do
    case Device.parse(source) do
      {:ok, {driver, _}} when driver in [Device.V4L2, Device.Input] ->
        {sound, pictures} = Keyword.split(opts, [:audio_format, :audio_buffer])
        video = Camera.open(p, [device: source] ++ pictures)
        audio = microphone && Microphone.open(p, [device: microphone] ++ sound)
        %{video: video, audio: audio}

      {:ok, _} ->
        Map.merge(%{video: nil, audio: nil}, LiveStream.open(p, [device: source] ++ opts))

      {:error, _} ->
        # Neither a device nor a file: the file's error says more.
        VideoFile.open(p, source, opts)
    end
  end
end
