defmodule Situ.Studio.Sensor do
  @moduledoc """
  Reads a browser's camera and microphone through a page of the studio, on this machine or on a phone.

      sensor = Situ.Studio.Sensor.open(p, page: "phone")
      sensor.video |> Situ.map(&Situ.ImageOps.parse!(&1.data), type: Situ.Image)
      sensor.audio |> Situ.AudioStream.resample(16_000)
      Situ.Studio.Sensor.Speaker.play(answer, page: "phone")

  The user opens `/sensor?name=phone` in the studio, selects a camera and a microphone and starts them. Browsers allow
  this on localhost, and on other machines only over TLS (`Situ.Studio`, `tls: :own`).

  | output | value |
  |---|---|
  | `:video` | JPEG images, `Situ.EncodedImage` |
  | `:audio` | audio at the browser's rate (usually 48 kHz), 16 bit, mono; each chunk is timestamped at its end |
  | `:clock` | the offset of the browser's clock in ms, after every measurement |

  Times are from the browser, corrected by the clock offset. The offset is measured with short round trips; its error
  is at most half of the shortest round trip. The browser captures an image when the pipeline has consumed the
  previous one, so for a slow pipeline frames are skipped before they are encoded.
  """

  @schema [
    page: [
      type: :string,
      default: "page",
      doc: "The page's name; its address in the studio is `/sensor?name=NAME`."
    ],
    buffer: [
      type: :pos_integer,
      default: 200,
      doc: "The number of audio chunks buffered for a slow pipeline; the oldest are dropped."
    ],
    end_with_page: [
      type: :boolean,
      default: false,
      doc:
        "Ends the streams when the page disconnects, or when no page has connected within five minutes. By default, " <>
          "the sensor waits for another page."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  alias Situ.{AudioBuffer, AudioFormat, EncodedImage}
  alias Situ.Studio.FrameSchema
  alias Situ.Studio.Sensor.PageSource

  @behaviour Situ.Studio.Sensor.Packet
  @outputs [video: EncodedImage, audio: AudioBuffer, clock: :float]
  @rates 8_000..192_000
  @camera FrameSchema.code(:device, :camera)
  @microphone FrameSchema.code(:device, :microphone)

  @doc "Adds the sensor to a pipeline; returns its streams."
  @spec open(Situ.Pipeline.t(), keyword()) :: %{
          video: Situ.Stream.t(),
          audio: Situ.Stream.t(),
          clock: Situ.Stream.t()
        }
  def open(p, opts \\ []) do
    fixed = [sensor: __MODULE__, credited: :video, ahead: 2]
    placement = [default_name: "Sensor", outputs: @outputs]
    Situ.source(p, PageSource, fixed ++ placement ++ Keyword.put_new(opts, :page, "page"))
  end

  @doc false
  @impl true
  def parse(<<@camera, _::binary>> = bytes) do
    with {%{width: w, height: h, time: ms}, jpeg} when w > 0 and h > 0 <-
           FrameSchema.decode(:camera, bytes),
         {:ok, :jpeg} <- EncodedImage.detect_format(jpeg),
         do: {ms, video: %EncodedImage{format: :jpeg, width: w, height: h, data: jpeg}},
         else: (_ -> :error)
  end

  def parse(<<@microphone, _::binary>> = bytes) do
    with {%{rate: rate, time: ms}, pcm} when rate in @rates and pcm != "" <-
           FrameSchema.decode(:microphone, bytes),
         0 <- rem(byte_size(pcm), 2),
         {:ok, buffer} <- AudioBuffer.new(format: AudioFormat.pcm(rate), data: pcm),
         do: {ms, audio: buffer},
         else: (_ -> :error)
  end

  def parse(_), do: :error
end
