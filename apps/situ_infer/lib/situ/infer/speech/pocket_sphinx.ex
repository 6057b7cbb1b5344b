defmodule Situ.Infer.Speech.PocketSphinx do
  @schema [
    grammar: [
      type: {:optional, :string},
      default: nil,
      doc:
        "What may be said: a grammar in JSGF, or the path of a file with one; `nil`: anything, heard badly."
    ],
    keyword: [
      type: {:optional, :string},
      default: nil,
      doc: "One phrase that is waited for in place of a grammar; all else is nothing."
    ],
    threshold: [
      type: {:range, 1.0e-50, 1.0},
      default: 1.0e-20,
      doc:
        "How sure it must be of the keyword: smaller hears it more often, also where nobody said it."
    ]
  ]

  @moduledoc """
  Speech to text by the program PocketSphinx: small and quick, for the sentences of a grammar or a keyword. Of free
  speech it gets a third of the words wrong; `Situ.Infer.Speech.Moonshine` is for that.

      {:ok, sphinx} = Situ.Infer.Speech.PocketSphinx.load(grammar: "robot.gram")
      {:ok, %{text: "go forward ten meters"}} = Situ.Infer.Speech.PocketSphinx.transcribe(sphinx, buffer)

  It comes with Debian: `apt-get install pocketsphinx pocketsphinx-en-us` (English, BSD). Each piece of sound is a run
  of the program, about 0.2 s of one core. It tells no confidence: that is 0.5 for words and 0.0 for none.

  ## Options

  #{Situ.Options.docs(@schema)}

  ## Errors

  `:no_pocketsphinx`, `:bad_grammar`, `:no_grammar`, `:recognition_failed`.
  """
  @behaviour Situ.Infer.Speech.Recognizer
  alias Situ.{Error, Sound}
  alias Situ.Intent.Jsgf

  @program "pocketsphinx_continuous"
  # Nothing it is asked takes so long.
  @seconds 120

  @enforce_keys [:program, :grammar, :keyword, :threshold]
  defstruct [:program, :grammar, :keyword, :threshold]

  @type t :: %__MODULE__{
          program: Path.t(),
          grammar: String.t() | nil,
          keyword: String.t() | nil,
          threshold: float()
        }

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, program} <- program(),
         {:ok, grammar} <- grammar(opts[:grammar]) do
      {:ok,
       %__MODULE__{
         program: program,
         grammar: grammar,
         keyword: opts[:keyword],
         threshold: opts[:threshold] / 1
       }}
    end
  end

  defp program do
    case System.find_executable(@program) do
      nil ->
        {:error,
         Error.new(:no_pocketsphinx, "the program #{@program} is not installed",
           fix: "install it: apt-get install pocketsphinx pocketsphinx-en-us"
         )}

      path ->
        {:ok, path}
    end
  end

  defp grammar(nil), do: {:ok, nil}

  defp grammar(given) do
    with {:ok, text} <- text(given), {:ok, _} <- Jsgf.parse(text), do: {:ok, text}
  end

  defp text("#JSGF" <> _ = text), do: {:ok, text}

  defp text(path) do
    with {:error, why} <- File.read(path) do
      what = "cannot read a grammar: #{:file.format_error(why)}"
      {:error, Error.new(:no_grammar, what, fix: "check the path #{path}")}
    end
  end

  @impl true
  @spec transcribe(t(), Situ.AudioBuffer.t()) ::
          {:ok, Situ.Infer.Speech.Recognizer.result()} | {:error, Error.t()}
  def transcribe(%__MODULE__{} = sphinx, buffer) do
    folder =
      Path.join(
        System.tmp_dir!(),
        "situ-sphinx-#{System.pid()}-#{System.unique_integer([:positive])}"
      )

    with {:ok, mono} <- Sound.reformat(buffer, channels: 1, sample: :s16),
         {:ok, sound} <- Sound.resample(mono, 16_000) do
      File.mkdir_p!(folder)

      try do
        File.write!(Path.join(folder, "sound.raw"), sound.data)
        run(sphinx, folder)
      after
        File.rm_rf!(folder)
      end
    end
  end

  defp run(sphinx, folder) do
    command =
      ["timeout", "-k", "1", "#{@seconds}", sphinx.program, "-logfn", "/dev/null"] ++
        ["-infile", Path.join(folder, "sound.raw")] ++ search(sphinx, folder)

    case System.cmd("/bin/sh", ["-c", ~S(exec "$@" 2>/dev/null), "situ-speech" | command]) do
      {heard, 0} ->
        text = heard |> String.split() |> Enum.join(" ")
        {:ok, %{text: text, confidence: if(text == "", do: 0.0, else: 0.5)}}

      {_, status} ->
        {:error,
         Error.new(:recognition_failed, "#{@program} ended with status #{status}",
           why: "a word of the grammar or keyword may be missing in its dictionary",
           fix: "run it by hand with -jsgf and without -logfn"
         )}
    end
  end

  defp search(%{keyword: keyword} = sphinx, _folder) when is_binary(keyword),
    do: ["-keyphrase", keyword, "-kws_threshold", Float.to_string(sphinx.threshold)]

  defp search(%{grammar: nil}, _folder), do: []

  defp search(%{grammar: grammar}, folder) do
    path = Path.join(folder, "grammar.gram")
    File.write!(path, grammar)
    ["-jsgf", path]
  end
end
