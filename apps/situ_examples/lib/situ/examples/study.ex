defmodule Situ.Examples.Study do
  @usage """
  Usage: bin/demo --dataset [--input FILE --truth FILE.json]... [--out FOLDER] [--json]

  Runs a complete study: adds clips as sessions of a dataset, detects from audio and lips who is speaking, stores the
  results as proposed annotations, exports them to ELAN and WebVTT, and compares them with the ground truth (Cohen's
  kappa over frames of 10 ms).

    --input FILE     a clip; may be given several times (default: the three clips included with Situ)
    --truth FILE     the ground truth of the preceding clip
    --out FOLDER     folder for the study (default: "study")
    --json           print one JSON object and nothing else

  Exit status: 0 success, 1 failure, 2 wrong usage.
  """
  @moduledoc """
  The `bin/demo --dataset` command: processes and annotates a dataset of clips, exports the annotations, and compares
  them with the ground truth.

  ```text
  #{@usage}
  ```
  """
  use Situ.Pipeline

  alias Situ.Annotation
  alias Situ.Annotation.{Agreement, Exchange, Layer, Recording, Schema, Segmenting}
  alias Situ.Dataset
  alias Situ.Dataset.{Derivation, Importer, OpenSession}
  alias Situ.Error
  alias Situ.Examples.Demo.Truth
  alias Situ.Infer.{MouthShape, VoiceActivity}

  @output "Speech"
  @frame Situ.Time.ms(10)

  @doc "Returns the schema of the annotations: each face has a track that is annotated while the face speaks."
  @spec schema() :: Schema.t()
  def schema, do: Schema.finite("Speech", ["speaks"])

  @doc "Builds the pipeline for one session, which writes proposed annotations of speech and the mouths of all faces."
  @impl true
  def build(_p, opts) do
    {importer, exporter} = {opts[:importer], opts[:exporter]}

    sound =
      importer
      |> Importer.stream("Audio")
      |> Situ.Audio.resample(16_000)

    voice = Situ.via(sound, VoiceActivity, name: "VoiceActivity").voice
    lips = importer |> Importer.stream("Video") |> MouthShape.parts()

    lips.mouths
    |> Situ.Infer.who_speaks(voice)
    |> Segmenting.from_keys(fn _face, speaks? -> speaks? && %{"Speech" => "speaks"} end,
      proposed: true,
      by: "who_speaks"
    )
    |> Situ.Store.write(exporter, @output, metadata: Schema.to_json(schema()))

    Situ.Store.write(lips.mouths, exporter, "Mouths")
  end

  @doc "Runs the study and returns the exit status."
  @spec run([String.t()]) :: 0 | 1 | 2
  def run(argv) do
    switches = [
      input: :keep,
      truth: :keep,
      out: :string,
      json: :boolean,
      dataset: :boolean,
      help: :boolean,
      headless: :boolean
    ]

    case OptionParser.parse(argv, strict: switches) do
      {opts, [], []} ->
        if opts[:help], do: usage(), else: study(opts)

      {_, [word | _], _} ->
        fail("unexpected argument #{inspect(word)}\n  Fix: see bin/demo --dataset --help", 2)

      {_, _, [{switch, _} | _]} ->
        fail("unknown or incomplete option #{switch}\n  Fix: see bin/demo --dataset --help", 2)
    end
  end

  defp usage do
    IO.puts(@usage)
    0
  end

  defp study(opts) do
    {:ok, _} = Application.ensure_all_started(:situ_examples)
    {:ok, _} = Application.ensure_all_started(:situ_dataset)
    clips = clips(for {key, path} <- opts, key in [:input, :truth], do: {key, path})

    with {:ok, dataset} <- dataset(clips, opts[:out] || "study"),
         {:ok, dataset, report} <-
           Dataset.derive(dataset, __MODULE__, output: @output, path: Path.dirname(dataset.file)),
         [] <- Derivation.Report.failures(report),
         {:ok, results} <- results(clips, dataset) do
      if opts[:json],
        do: IO.puts(Situ.JSON.encode(%{file: dataset.file, sessions: results})),
        else: print(dataset, results)

      0
    else
      [{session, error} | _] -> fail("session #{session}: #{Exception.message(error)}", 1)
      {:error, error} -> fail(Exception.message(error), 1)
    end
  rescue
    error in Error -> fail(Exception.message(error), 1)
  end

  defp fail(text, status) do
    IO.puts(:stderr, "bin/demo: " <> text)
    status
  end

  # Each truth file belongs to the clip before it.
  defp clips([]) do
    folder = Application.app_dir(:situ_examples, "priv/demo")

    for clip <- ~w(talk1 talk2 talk3),
        do: {Path.join(folder, clip <> ".mp4"), Path.join(folder, clip <> ".truth.json")}
  end

  defp clips([{:input, clip}, {:truth, truth} | rest]), do: [{clip, truth} | more(rest)]
  defp clips([{:input, clip} | rest]), do: [{clip, nil} | more(rest)]
  defp clips([{:truth, _} | rest]), do: more(rest)
  defp more([]), do: []
  defp more(rest), do: clips(rest)

  defp dataset(clips, folder) do
    with {:ok, dataset} <-
           Dataset.new("Who speaks", file: Path.join(folder, "study.json"), autosave: true) do
      Enum.reduce_while(clips, {:ok, dataset}, fn {clip, _}, {:ok, dataset} ->
        name = Path.basename(clip, Path.extname(clip))

        with {:ok, dataset} <- Dataset.add_session(dataset, name),
             {:ok, dataset} <- Dataset.add_partition(dataset, name, "Clip", clip) do
          {:cont, {:ok, dataset}}
        else
          error -> {:halt, error}
        end
      end)
    end
  end

  defp results(clips, dataset) do
    clips
    |> Enum.zip(dataset.sessions)
    |> Enum.reduce_while({:ok, []}, fn {{clip, truth}, session}, {:ok, results} ->
      case result(clip, truth, session, Path.dirname(dataset.file)) do
        {:ok, result} -> {:cont, {:ok, [result | results]}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
    |> then(&with({:ok, results} <- &1, do: {:ok, Enum.reverse(results)}))
  end

  defp result(clip, truth, session, folder) do
    open = OpenSession.open(session)

    with {:ok, {_, store, _}} <- OpenSession.find(open, @output),
         {:ok, layer} <- Recording.load(store, @output),
         {:ok, {_, film, _}} <- OpenSession.find(open, "Video"),
         {start, _} = Situ.Store.interval(film),
         eaf = Path.join(folder, session.name <> ".eaf"),
         vtt = Path.join(folder, session.name <> ".vtt"),
         {:ok, lost} <- Exchange.write(layer, eaf, origin: start, media: clip),
         {:ok, also} <- Exchange.write(layer, vtt, origin: start),
         {:ok, kappa} <- kappa(truth, layer, store, start) do
      {:ok,
       %{
         session: session.name,
         annotations: length(Layer.annotations(layer)),
         tracks: Layer.tracks(layer),
         kappa: kappa,
         files: [eaf, vtt],
         losses: Enum.uniq(lost ++ also)
       }}
    end
  end

  defp kappa(nil, _layer, _store, _start), do: {:ok, nil}

  defp kappa(path, layer, store, start) do
    with {:ok, truth} <- Truth.read(path),
         {:ok, real} <- truth_layer(truth, faces(store, truth), start),
         stop = start + Situ.Time.s(truth.frames / truth.fps),
         {:ok, report} <- Agreement.of(real, layer, frame: @frame, from: start, to: stop) do
      {:ok, report.kappa}
    end
  end

  # Maps each tracked face to the true face that is horizontally nearest when the track first appears.
  defp faces(store, truth) do
    for message <- Situ.Store.messages(store, "Mouths"),
        {id, mouth} <- message.data,
        reduce: %{} do
      seen -> Map.put_new(seen, id, nearest(mouth.rect, truth.faces))
    end
  end

  defp nearest(rect, faces) do
    {face, _} = Enum.min_by(faces, fn {_, box} -> abs(centre(rect) - centre(box)) end)
    face
  end

  defp centre(rect), do: rect.x + rect.width / 2

  defp truth_layer(truth, faces, start) do
    tracks = Map.new(faces, fn {id, face} -> {face, to_string(id)} end)

    annotations =
      for {face, from, to} <- truth.speech, face != nil do
        track = Map.get(tracks, face, "face #{face}")

        Annotation.new(start + Situ.Time.s(from / 1), start + Situ.Time.s(to / 1), track, %{
          "Speech" => "speaks"
        })
      end

    Layer.new(schema(), annotations)
  end

  defp print(dataset, results) do
    IO.puts("#{dataset.name}: #{dataset.file}")

    for result <- results do
      kappa =
        if result.kappa, do: ", kappa #{Float.round(result.kappa, 3)} against the truth", else: ""

      IO.puts(
        "  #{result.session}: #{result.annotations} proposed annotations " <>
          "on tracks #{Enum.join(result.tracks, ", ")}#{kappa}"
      )

      for file <- result.files, do: IO.puts("    #{file}")
      for loss <- result.losses, do: IO.puts("    lost: #{loss}")
    end

    IO.puts(
      "Next: run bin/situ dataset info #{dataset.file}, then accept or reject the proposals in the studio."
    )
  end
end
