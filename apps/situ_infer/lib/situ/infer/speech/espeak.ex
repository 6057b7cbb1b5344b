defmodule Situ.Infer.Speech.Espeak do
  @moduledoc """
  Text to speech with the program espeak-ng. It supports more than a hundred languages, runs 50 times faster than real
  time, and sounds robotic.

      {:ok, voice} = Situ.Infer.Speech.Espeak.load(rate: 180)
      {:ok, sound} = Situ.Infer.Speech.Espeak.speak(voice, "Go forward ten metres.")
      {:ok, sound, marks} = Situ.Infer.Speech.Espeak.speak_with_marks(voice, "Go forward ten metres.")

  Marks (`Situ.Infer.Speech.Mark`) are sentences, words, phonemes and, with `ssml: true`, the text's own marks. They are
  produced by espeak-ng's library, which runs in a small separate program (`apps/situ_infer/native/situ_speak`).

  ## Errors

  `:no_espeak` (not installed), `:bad_voice` (unknown voice), `:bad_text`, `:synthesis_failed`.
  """

  @schema [
    voice: [type: :string, default: "en-us", doc: "A voice listed by `espeak-ng --voices`."],
    rate: [type: {:range, 80, 450}, default: 160, doc: "The speed in words per minute."],
    pitch: [type: {:range, 0, 99}, default: 50, doc: "The pitch."],
    ssml: [
      type: :boolean,
      default: false,
      doc:
        "The text is SSML: `<break>`, `<emphasis>`, `<mark>`, `<prosody>`, `<say-as>`, `<voice>` ...; unknown and " <>
          "unclosed tags are removed, as is `<audio>`, which could play any file of this machine."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Infer.Speech.Synthesizer

  alias Situ.{AudioBuffer, Error}
  alias Situ.Infer.Speech.Espeak.OutputParser
  alias Situ.Infer.Speech.{Mark, Program, TextCheck}
  alias Situ.Media.Wav.Format

  # Linux limits a program argument to 128 KiB.
  @longest 100_000
  # No valid text takes this long.
  @seconds 60

  @enforce_keys [:program, :arguments, :marker]
  defstruct [:program, :arguments, :marker]
  @type t :: %__MODULE__{program: Path.t(), arguments: [String.t()], marker: [String.t()]}

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, program} <- Program.find_espeak() do
      [rate, pitch] = for key <- [:rate, :pitch], do: "#{round(opts[key])}"

      arguments =
        ["-v", opts[:voice], "-s", rate, "-p", pitch] ++ if(opts[:ssml], do: ["-m"], else: [])

      marker = [opts[:voice], rate, pitch, if(opts[:ssml], do: "ssml", else: "text")]
      voice = %__MODULE__{program: program, arguments: arguments, marker: marker}

      # Speaks once so that an unknown voice is reported by `load/1` and not by the first sentence.
      with {:ok, _} <- speak(voice, "a"), do: {:ok, voice}
    end
  end

  @impl true
  @spec speak(t(), String.t()) :: AudioBuffer.result()
  def speak(%__MODULE__{} = voice, text) do
    case prepare_text(voice, text) do
      {:ok, text} -> run_espeak(voice, text)
      :nothing -> silent_audio()
      error -> error
    end
  end

  @impl true
  @spec speak_with_marks(t(), String.t()) ::
          {:ok, AudioBuffer.t(), [Mark.t()]} | {:error, Error.t()}
  def speak_with_marks(%__MODULE__{} = voice, text) do
    case prepare_text(voice, text) do
      {:ok, text} -> run_mark_program(voice, text)
      :nothing -> with {:ok, sound} <- silent_audio(), do: {:ok, sound, []}
      error -> error
    end
  end

  # Returns the text to pass to espeak-ng.
  defp prepare_text(voice, text) do
    text = if "-m" in voice.arguments, do: remove_audio_tags(text), else: text
    with :ok <- TextCheck.check_text(text, @longest), do: {:ok, text}
  end

  # Removing a tag may form a new tag from the surrounding text, so this repeats until nothing changes.
  defp remove_audio_tags(text) do
    if String.valid?(text) do
      case String.replace(text, ~r{<\s*/?\s*audio\b[^>]*(>|\z)}i, "") do
        ^text -> text
        less -> remove_audio_tags(less)
      end
    else
      text
    end
  end

  defp silent_audio, do: AudioBuffer.new(format: Situ.AudioFormat.pcm(22_050), data: "")

  defp run_espeak(voice, text) do
    command = [voice.program, "--stdout"] ++ voice.arguments ++ ["--", text]

    case Program.run(command, @seconds) do
      {wav, 0} -> parse_wav(wav)
      {_, status} -> {:error, synthesis_error(voice, status)}
    end
  end

  defp run_mark_program(voice, text) do
    program = Application.app_dir(:situ_infer, "priv/native/situ_speak")

    case Program.run([program | voice.marker] ++ [text], @seconds) do
      {bytes, 0} ->
        with :error <- OutputParser.parse(bytes, text),
             do: {:error, synthesis_error(voice, "0, cut short")}

      {_, 3} ->
        {:error,
         Error.new(:no_espeak, "cannot load the espeak-ng library",
           why: "marks require libespeak-ng.so.1",
           fix: "install it: apt-get install espeak-ng"
         )}

      {_, 4} ->
        {:error, synthesis_error(voice, 1)}

      {_, status} ->
        {:error, synthesis_error(voice, status)}
    end
  end

  # The header is written before the data and announces a size that is too large.
  defp parse_wav(
         <<"RIFF", _::32, "WAVEfmt ", 16::little-32, format::binary-16, "data", _::32,
           data::binary>>
       ) do
    with {:ok, format} <- Format.parse_chunk(format) do
      AudioBuffer.new(format: format, data: binary_part(data, 0, div(byte_size(data), 2) * 2))
    end
  end

  defp parse_wav(_), do: silent_audio()

  defp synthesis_error(%{arguments: ["-v", voice | _]}, 1) do
    Error.new(:bad_voice, "espeak-ng has no voice #{inspect(voice)}",
      fix: "use a voice listed by `espeak-ng --voices`"
    )
  end

  defp synthesis_error(_voice, status),
    do: Error.new(:synthesis_failed, "espeak-ng exited with status #{status}")
end
