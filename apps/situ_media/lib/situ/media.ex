defmodule Situ.Media do
  @moduledoc """
  Images and audio from files, devices and the network.

      def build(p, opts) do
        # "talk1.mp4", "/dev/video0", "rtsp://...", "simulated:talk1.mp4"
        clip = Situ.Media.open(p, opts[:source])
        clip.video |> Situ.each(&IO.inspect/1)
      end

  | to read | | to write | |
  |---|---|---|---|
  | `Situ.Media.VideoFile` | any media file | `Situ.Media.VideoWriter` | MP4, MKV, WebM ... |
  | `Situ.Media.WavFile` | WAV | `Situ.Media.WavWriter` | WAV |
  | `Situ.Media.ImageSequence` | JPEG, PNG files | `Situ.Media.ImageSequenceWriter` | JPEG, PNG files |
  | `Situ.Media.Camera`, `Situ.Media.Microphone` | devices | `Situ.Media.Speaker` | devices |
  | `Situ.Media.LiveStream` | the network, simulated devices | | |

  ## Media files as recordings

  `Situ.Store.open("talk1.mp4")` opens a media file like a recording with the streams `Video` and `Audio`, and
  everything that opens recordings supports it: the studio, `situ store info`, and replay in a pipeline.

      {:ok, store} = Situ.Store.open("talk1.mp4")
      {:ok, message} = Situ.Store.latest_at(store, "Video", Situ.Time.ms(1_500))
      %Situ.Image{width: 1024, height: 512} = message.data

  Times are those of `Situ.Media.VideoFile`; `reader_opts: [start: time]` replaces the file's own start time. Images
  are `:bgr24`, and audio has 16 bits, in buffers of 20 ms. Opening lists the file's packets, which takes about half a
  second, or longer for videos of several hours. Images are decoded on request, so files with a key frame every few
  seconds are the fastest to scrub. A damaged file returns all readable data, then the error `:damaged_media`. `size`
  of a stream is the size of its decoded data, and `stored` is the size of its packets.

  Extensions: #{Enum.map_join(Situ.Media.Recording.extensions(), " ", &"`#{&1}`")}.

  The guide "Files and devices" has more examples.
  """
  alias Situ.Media.{Camera, Device, LiveStream, Microphone, VideoFile}
  alias Situ.Media.StoredVideo.FileCopy

  @copy_options [
    from: [
      type: {:optional, :integer},
      default: nil,
      doc: "The first originating time. The file begins with the key frame at or before it."
    ],
    to: [type: {:optional, :integer}, default: nil, doc: "The last originating time."],
    progress: [
      type: {:optional, {:fun, 1}},
      default: nil,
      doc: "Called with the number of images that are written."
    ]
  ]

  @doc """
  Writes a stream that is stored as video (`encode:` of `Situ.Store.write/4`) to a file (`.mp4`, `.mov`, `.mkv`,
  `.webm`) without encoding it again: `{:ok, count}`. Times are rounded to 1/90,000 s (1 ms in MKV and WebM). All images
  must have the same size.

  #{Situ.Options.docs(@copy_options)}
  """
  @spec copy_video(Situ.Store.t(), String.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Situ.Error.t()}
  def copy_video(store, stream, path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @copy_options),
         do: FileCopy.write_file(store, stream, path, opts)
  end

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
