defmodule Situ.Infer.Speech.Upload do
  @moduledoc false
  # Requests to services: sound as a WAV file in memory, forms, text as SSML.
  alias Situ.{AudioBuffer, Error, Sound}

  @rate 16_000
  @longest_text 20_000

  @doc "16 kHz mono sound as the bytes of a WAV file."
  @spec wav(AudioBuffer.t()) :: {:ok, binary()} | {:error, Error.t()}
  def wav(sound) do
    with {:ok, mono} <- Sound.reformat(sound, channels: 1, sample: :s16),
         {:ok, %{data: data}} <- Sound.resample(mono, @rate) do
      size = byte_size(data)

      {:ok,
       <<"RIFF", 36 + size::little-32, "WAVEfmt ", 16::little-32, 1::little-16, 1::little-16,
         @rate::little-32, 2 * @rate::little-32, 2::little-16, 16::little-16, "data",
         size::little-32, data::binary>>}
    end
  end

  @doc "A form with a file: its content type and body."
  @spec form([{String.t(), String.t()}], {String.t(), String.t(), String.t(), binary()}) ::
          {String.t(), iodata()}
  def form(fields, {name, file, type, bytes}) do
    # Nobody's sound holds a random number of 128 bits.
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

  @doc "Whether a text can be sent to be spoken; `:nothing` when there is nothing in it."
  @spec text(String.t()) :: :ok | :nothing | {:error, Error.t()}
  def text(text) do
    cond do
      not String.valid?(text) or String.contains?(text, <<0>>) -> bad("it is not text")
      byte_size(text) > @longest_text -> bad("it has more than #{@longest_text} bytes")
      not String.match?(text, ~r/[\p{L}\p{N}\p{S}]/u) -> :nothing
      true -> :ok
    end
  end

  defp bad(why) do
    {:error, Error.new(:bad_text, "this cannot be spoken", why: why, fix: "give it in sentences")}
  end

  @doc "The error of an answer that is not in the service's protocol."
  @spec bad_answer() :: Error.t()
  def bad_answer do
    Error.new(:bad_answer, "the service's answer has an unexpected form",
      fix: "check the URL: another kind of service may be there"
    )
  end

  @doc "Text as part of an XML document."
  @spec escape(String.t()) :: String.t()
  def escape(text) do
    text
    |> String.replace(~r/[\x00-\x08\x0b\x0c\x0e-\x1f]/, "")
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace("\"", "&quot;")
    |> String.replace("'", "&apos;")
  end
end
