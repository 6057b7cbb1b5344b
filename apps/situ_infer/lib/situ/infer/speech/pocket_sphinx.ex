defmodule Situ.Infer.Speech.PocketSphinx do
  @moduledoc """
  Speech to text with the program PocketSphinx, which is small and fast, for the sentences of a grammar or a keyword.
  It misrecognizes a third of the words of free speech; use `Situ.Infer.Speech.Moonshine` for free speech.

      {:ok, sphinx} = Situ.Infer.Speech.PocketSphinx.load(grammar: "robot.gram")
      {:ok, %{text: "go forward ten meters"}} = Situ.Infer.Speech.PocketSphinx.transcribe(sphinx, buffer)

  It is part of Debian: `apt-get install pocketsphinx pocketsphinx-en-us` (English, BSD). Each chunk runs the program
  twice and takes about 0.3 s of CPU time. Results contain alternatives, and words with times.

  With a grammar, any audio is recognized as one of its sentences. Therefore the audio is also decoded as a free
  sequence of phones, and `confidence` is computed from the likelihood of the sentence relative to that of the phones.
  In recordings, sentences of a grammar have a confidence of 0.7 or more, and other speech 0.2 or less. Without a
  grammar, `confidence` is the weight of the best result among all alternatives.

  ## Errors

  `:no_pocketsphinx`, `:bad_grammar`, `:no_grammar`, `:recognition_failed`.
  """

  @schema [
    grammar: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The sentences to recognize: a JSGF grammar, or the path of its file; `nil` accepts any, with many errors."
    ],
    keyword: [
      type: {:optional, :string},
      default: nil,
      doc: "One phrase to detect instead of using a grammar; all other speech is ignored."
    ],
    threshold: [
      type: {:range, 1.0e-50, 1.0},
      default: 1.0e-20,
      doc:
        "The detection threshold for the keyword; a smaller value detects it more often, with more false detections."
    ],
    alternatives: [
      type: {:range, 0, 20},
      default: 3,
      doc: "The maximum number of alternative sentences in a result."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Infer.Speech.Recognizer
  alias Situ.{Error, AudioOps}
  alias Situ.Infer.Speech.{Jsgf, Program}
  alias Situ.Infer.Speech.Jsgf.Matcher
  alias Situ.Infer.Speech.PocketSphinx.OutputParser

  @program "pocketsphinx_batch"
  @listener "pocketsphinx_continuous"
  # Decodes any sequence of phones, which matches any speech.
  @phones ["-allphone_ci", "yes", "-beam", "1e-10", "-pbeam", "1e-10", "-lw", "2.0"]
  # The beam is wide enough to keep alternative sentences.
  @wide ["-wbeam", "1e-120", "-beam", "1e-120", "-pbeam", "1e-120"]
  @phone_model "en-us/en-us-phone.lm.bin"
  # No valid audio takes this long.
  @seconds 120

  @enforce_keys [:program, :listener, :phones, :grammar, :keyword, :threshold, :alternatives]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          program: Path.t(),
          listener: Path.t(),
          phones: Path.t(),
          alternatives: non_neg_integer(),
          grammar: {String.t(), Jsgf.t()} | nil,
          keyword: String.t() | nil,
          threshold: float()
        }

  @impl true
  @spec load(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, program} <- find_program(@program),
         {:ok, listener} <- find_program(@listener),
         {:ok, phones} <- find_phone_model(),
         {:ok, grammar} <- load_grammar(opts[:grammar]) do
      {:ok,
       %__MODULE__{
         program: program,
         listener: listener,
         phones: phones,
         grammar: grammar,
         keyword: opts[:keyword],
         threshold: opts[:threshold] / 1,
         alternatives: round(opts[:alternatives])
       }}
    end
  end

  defp find_program(name) do
    case System.find_executable(name) do
      nil -> {:error, not_installed_error("the program #{name} is not installed")}
      path -> {:ok, path}
    end
  end

  defp find_phone_model do
    folders = [System.get_env("POCKETSPHINX_PATH"), "/usr/share/pocketsphinx/model"]

    folders
    |> Enum.filter(& &1)
    |> Enum.map(&Path.join([&1, @phone_model]))
    |> Enum.find(&File.regular?/1)
    |> case do
      nil -> {:error, not_installed_error("PocketSphinx has no English model")}
      path -> {:ok, path}
    end
  end

  defp not_installed_error(what) do
    Error.new(:no_pocketsphinx, what,
      fix: "install it: apt-get install pocketsphinx pocketsphinx-en-us"
    )
  end

  defp load_grammar(nil), do: {:ok, nil}

  defp load_grammar(given) do
    with {:ok, text} <- Jsgf.read_text(given),
         {:ok, jsgf} <- Jsgf.parse(text),
         do: {:ok, {text, jsgf}}
  end

  @impl true
  @spec transcribe(t(), Situ.AudioBuffer.t()) ::
          {:ok, Situ.Infer.Speech.Recognizer.result()} | {:error, Error.t()}
  def transcribe(%__MODULE__{} = sphinx, buffer) do
    with :ok <- Situ.Infer.SampleCheck.check_buffer(buffer),
         {:ok, mono} <- AudioOps.reformat(buffer, channels: 1, sample: :s16),
         {:ok, sound} <- AudioOps.resample(mono, 16_000) do
      Situ.TempFolder.with_folder("sphinx", fn folder ->
        File.write!(Path.join(folder, "sound.raw"), sound.data)
        File.write!(Path.join(folder, "list"), "sound\n")
        recognize_file(sphinx, folder)
      end)
    end
  end

  defp recognize_file(%{keyword: keyword} = sphinx, folder) when is_binary(keyword) do
    arguments = ["-infile", Path.join(folder, "sound.raw"), "-time", "yes"]
    phrase = ["-keyphrase", keyword, "-kws_threshold", Float.to_string(sphinx.threshold)]

    with {:ok, heard} <- run_program(sphinx.listener, arguments ++ phrase),
         do: {:ok, OutputParser.parse_keyword_output(heard)}
  end

  defp recognize_file(sphinx, folder) do
    several = ["-nbest", "#{40 * sphinx.alternatives}", "-nbestdir", folder]

    with {:ok, _} <-
           run_decoder(sphinx, folder, "hypothesis", search_arguments(sphinx, folder) ++ several) do
      hypothesis = OutputParser.parse_segments(read_output(folder, "hypothesis"))

      others =
        folder
        |> read_output("sound.hyp")
        |> OutputParser.parse_alternatives()
        |> filter_complete(sphinx.grammar)

      build_result(hypothesis, others, sphinx, folder)
    end
  end

  defp build_result(%{words: []}, _others, _sphinx, _folder),
    do: {:ok, %{text: "", confidence: 0.0, words: [], alternatives: []}}

  defp build_result(hypothesis, others, %{grammar: nil} = sphinx, _folder),
    do:
      {:ok,
       OutputParser.build_result(
         hypothesis,
         others,
         OutputParser.result_share(hypothesis, others),
         sphinx.alternatives
       )}

  defp build_result(hypothesis, others, sphinx, folder) do
    with {:ok, _} <- run_decoder(sphinx, folder, "phones", ["-allphone", sphinx.phones | @phones]) do
      phones = OutputParser.parse_segments(read_output(folder, "phones"))

      {:ok,
       OutputParser.build_result(
         hypothesis,
         others,
         OutputParser.phone_confidence(hypothesis, phones),
         sphinx.alternatives
       )}
    end
  end

  defp run_decoder(sphinx, folder, name, search) do
    sound = ["-adcin", "yes", "-cepdir", folder, "-cepext", ".raw", "-ctl", "#{folder}/list"]
    results = ["-hyp", "#{folder}/#{name}.text", "-hypseg", Path.join(folder, name)]
    run_program(sphinx.program, sound ++ results ++ search)
  end

  defp read_output(folder, name) do
    case File.read(Path.join(folder, name)) do
      {:ok, text} -> text
      {:error, _} -> ""
    end
  end

  defp run_program(program, arguments) do
    case Program.run([program, "-logfn", "/dev/null" | arguments], @seconds) do
      {heard, 0} ->
        {:ok, heard}

      {_, status} ->
        {:error,
         Error.new(:recognition_failed, "#{Path.basename(program)} exited with status #{status}",
           why: "a word of the grammar or keyword may be missing from its dictionary",
           fix: "run the program manually with -jsgf and without -logfn"
         )}
    end
  end

  defp search_arguments(%{grammar: nil}, _folder), do: []

  defp search_arguments(%{grammar: {grammar, _}} = sphinx, folder) do
    path = Path.join(folder, "grammar.gram")
    File.write!(path, grammar)
    ["-jsgf", path | if(sphinx.alternatives > 0, do: @wide, else: [])]
  end

  # PocketSphinx also lists incomplete sentences, which are removed.
  defp filter_complete(others, nil), do: others

  defp filter_complete(others, {_, jsgf}) do
    for {text, _} = other <- others,
        words = text |> String.split() |> List.to_tuple(),
        Enum.any?(
          jsgf.public,
          &match?([{n, _} | _] when n == tuple_size(words), match_ends(jsgf, &1, words))
        ),
        do: other
  end

  defp match_ends(jsgf, rule, words), do: Matcher.find_ends(jsgf, rule, words, 0)
end
