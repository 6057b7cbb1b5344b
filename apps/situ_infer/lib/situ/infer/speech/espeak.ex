defmodule Situ.Infer.Speech.Espeak do
  @schema [
    voice: [type: :string, default: "en-us", doc: "A voice of `espeak-ng --voices`."],
    rate: [type: {:range, 80, 450}, default: 160, doc: "Words a minute."],
    pitch: [type: {:range, 0, 99}, default: 50, doc: "How high."],
    ssml: [
      type: :boolean,
      default: false,
      doc:
        "The text is SSML: `<break>`, `<emphasis>`, `<mark>`, `<prosody>`, `<say-as>`, `<voice>` ...; tags that are " <>
          "not known or not closed are left out, and so is `<audio>`, which would play any file of this machine."
    ]
  ]

  @moduledoc """
  Text to speech by the program espeak-ng: more than a hundred languages, 50 times faster than speech, and it sounds
  like a robot.

      {:ok, voice} = Situ.Infer.Speech.Espeak.load(rate: 180)
      {:ok, sound} = Situ.Infer.Speech.Espeak.speak(voice, "Go forward ten metres.")
      {:ok, sound, marks} = Situ.Infer.Speech.Espeak.speak_marked(voice, "Go forward ten metres.")

  Marks (`Situ.Infer.Speech.Mark`) are sentences, words, sounds and, with `ssml: true`, the text's own marks. They come
  from espeak-ng's library, which a small program of Situ runs (`apps/situ_infer/native/situ_speak`).

  ## Options

  #{Situ.Options.docs(@schema)}

  ## Errors

  `:no_espeak` (not installed), `:bad_voice` (it does not know the voice), `:bad_text`, `:synthesis_failed`.
  """
  @behaviour Situ.Infer.Speech.Synthesizer

  alias Situ.{AudioBuffer, Error}
  alias Situ.Infer.Speech.Espeak.Frames
  alias Situ.Infer.Speech.Mark
  alias Situ.Media.Wav.Format

  # An argument of a program may be no longer than 128 KiB.
  @longest 100_000
  # Nothing it is asked takes so long.
  @seconds 60

  @enforce_keys [:program, :arguments, :marker]
  defstruct [:program, :arguments, :marker]
  @type t :: %__MODULE__{program: Path.t(), arguments: [String.t()], marker: [String.t()]}

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, program} <- program() do
      [rate, pitch] = for key <- [:rate, :pitch], do: "#{round(opts[key])}"

      arguments =
        ["-v", opts[:voice], "-s", rate, "-p", pitch] ++ if(opts[:ssml], do: ["-m"], else: [])

      marker = [opts[:voice], rate, pitch, if(opts[:ssml], do: "ssml", else: "text")]
      voice = %__MODULE__{program: program, arguments: arguments, marker: marker}
      # An unknown voice shows at once, not with the first sentence.
      with {:ok, _} <- speak(voice, "a"), do: {:ok, voice}
    end
  end

  defp program do
    case System.find_executable("espeak-ng") do
      nil ->
        {:error,
         Error.new(:no_espeak, "the program espeak-ng is not installed",
           why: "it turns text into sound",
           fix: "install it: apt-get install espeak-ng"
         )}

      path ->
        {:ok, path}
    end
  end

  @impl true
  @spec speak(t(), String.t()) :: AudioBuffer.result()
  def speak(%__MODULE__{} = voice, text) do
    case check(voice, text) do
      {:ok, text} -> run(voice, text)
      :nothing -> silence()
      error -> error
    end
  end

  @impl true
  @spec speak_marked(t(), String.t()) :: {:ok, AudioBuffer.t(), [Mark.t()]} | {:error, Error.t()}
  def speak_marked(%__MODULE__{} = voice, text) do
    case check(voice, text) do
      {:ok, text} -> mark(voice, text)
      :nothing -> with {:ok, sound} <- silence(), do: {:ok, sound, []}
      error -> error
    end
  end

  # The text that is given to espeak-ng.
  defp check(voice, text) do
    text = if "-m" in voice.arguments, do: harmless(text), else: text
    with :ok <- check(text), do: {:ok, text}
  end

  # Without a tag another may come together of what was around it.
  defp harmless(text) do
    if String.valid?(text) do
      case String.replace(text, ~r{<\s*/?\s*audio\b[^>]*(>|\z)}i, "") do
        ^text -> text
        less -> harmless(less)
      end
    else
      text
    end
  end

  defp check(text) do
    cond do
      not String.valid?(text) or String.contains?(text, <<0>>) -> bad("it is not text")
      byte_size(text) > @longest -> bad("it has more than #{@longest} bytes")
      # Nothing to be said: no letter, number or sign.
      not String.match?(text, ~r/[\p{L}\p{N}\p{S}]/u) -> :nothing
      true -> :ok
    end
  end

  defp silence, do: AudioBuffer.new(format: Situ.AudioFormat.pcm(22_050), data: "")

  defp bad(why),
    do:
      {:error,
       Error.new(:bad_text, "this cannot be spoken", why: why, fix: "give it in sentences")}

  defp run(voice, text) do
    case command([voice.program, "--stdout"] ++ voice.arguments ++ ["--", text]) do
      {wav, 0} -> sound(wav)
      {_, status} -> {:error, failed(voice, status)}
    end
  end

  # Its complaints would go to the terminal.
  defp command(command) do
    limited = ["timeout", "-k", "1", "#{@seconds}" | command]
    System.cmd("/bin/sh", ["-c", ~S(exec "$@" 2>/dev/null), "situ-speech" | limited])
  end

  defp mark(voice, text) do
    program = Application.app_dir(:situ_infer, "priv/native/situ_speak")

    case command([program | voice.marker] ++ [text]) do
      {bytes, 0} ->
        with :error <- Frames.parse(bytes, text), do: {:error, failed(voice, "half an answer")}

      {_, 3} ->
        {:error,
         Error.new(:no_espeak, "espeak-ng's library cannot be opened",
           why: "marks come from libespeak-ng.so.1",
           fix: "install it: apt-get install espeak-ng"
         )}

      {_, 4} ->
        {:error, failed(voice, 1)}

      {_, status} ->
        {:error, failed(voice, status)}
    end
  end

  # Its header announces more than there is, since it is written first.
  defp sound(
         <<"RIFF", _::32, "WAVEfmt ", 16::little-32, format::binary-16, "data", _::32,
           data::binary>>
       ) do
    with {:ok, format} <- Format.parse(format) do
      AudioBuffer.new(format: format, data: binary_part(data, 0, div(byte_size(data), 2) * 2))
    end
  end

  defp sound(_), do: silence()

  defp failed(%{arguments: ["-v", voice | _]}, 1) do
    Error.new(:bad_voice, "espeak-ng does not know the voice #{inspect(voice)}",
      fix: "choose one that `espeak-ng --voices` lists"
    )
  end

  defp failed(_voice, status),
    do: Error.new(:synthesis_failed, "espeak-ng ended with status #{status}")
end
