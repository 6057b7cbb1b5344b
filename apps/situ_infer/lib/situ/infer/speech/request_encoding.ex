defmodule Situ.Infer.Speech.RequestEncoding do
  @moduledoc false
  # The parts of requests that speech services share: audio as a WAV file in memory, forms, and the reply to
  # a text.
  alias Situ.{AudioBuffer, AudioFormat, AudioOps, Error}
  alias Situ.Infer.Speech.TextCheck

  @rate 16_000
  @longest_text 20_000

  @doc "Encodes audio as a 16 kHz mono WAV file."
  @spec encode_wav(AudioBuffer.t()) :: {:ok, binary()} | {:error, Error.t()}
  def encode_wav(sound) do
    with {:ok, mono} <- AudioOps.reformat(sound, channels: 1, sample: :s16),
         {:ok, %{data: data}} <- AudioOps.resample(mono, @rate) do
      size = byte_size(data)

      {:ok,
       <<"RIFF", 36 + size::little-32, "WAVEfmt ", 16::little-32, 1::little-16, 1::little-16,
         @rate::little-32, 2 * @rate::little-32, 2::little-16, 16::little-16, "data",
         size::little-32, data::binary>>}
    end
  end

  @doc "Encodes a form with a file; returns its content type and body."
  @spec encode_form([{String.t(), String.t()}], {String.t(), String.t(), String.t(), binary()}) ::
          {String.t(), iodata()}
  def encode_form(fields, {name, file, type, bytes}) do
    # A random boundary of 128 bits practically never occurs in the audio.
    border = "situ-" <> Base.encode16(:crypto.strong_rand_bytes(16))

    part =
      &[
        "--",
        border,
        "\r\ncontent-disposition: form-data; name=\"",
        &1,
        "\"",
        &2,
        "\r\n\r\n",
        &3,
        "\r\n"
      ]

    {"multipart/form-data; boundary=" <> border,
     [
       for({key, value} <- fields, do: part.(key, "", value)),
       part.(name, ["; filename=\"", file, "\"\r\ncontent-type: ", type], bytes),
       "--",
       border,
       "--\r\n"
     ]}
  end

  @doc """
  Returns the audio of a text, which `request` obtains from a service as 16-bit samples. Text without words needs no
  request.
  """
  @spec speak_text(String.t(), pos_integer(), (() -> {:ok, binary()} | {:error, Error.t()})) ::
          AudioBuffer.result()
  def speak_text(text, rate, request) do
    format = AudioFormat.pcm(rate)

    with :ok <- TextCheck.check_text(text, @longest_text),
         {:ok, data} <- request.() do
      # An incomplete sample at the end of the stream is dropped.
      even = byte_size(data) - rem(byte_size(data), 2)
      AudioBuffer.new(format: format, data: binary_part(data, 0, even))
    else
      :nothing -> AudioBuffer.new(format: format, data: "")
      error -> error
    end
  end
end
