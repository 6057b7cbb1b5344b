defmodule Situ.Examples.ClipVariants do
  @moduledoc false
  # Makes a dataset of many sessions out of a few clips, for experiments: each clip as it is, mirrored, with noise, with
  # a voice from outside the image, and with the sound of another clip. The ground truth follows from the clip's: only
  # the mirrored variant moves the faces, and with the sound of another clip, nobody in the image speaks.
  alias Situ.Annotation.{Layer, Recording, Schema}
  alias Situ.{Annotation, Dataset, Error, Store}
  alias Situ.Dataset.{Partition, Session}
  alias Situ.Examples.Demo.GroundTruth

  @conditions [:plain, :mirrored, :noisy, :voices, :dubbed]
  @delay_s 1.5

  @type clip :: {video :: Path.t(), truth :: Path.t()}

  @doc """
  Makes the dataset `folder/study.json` with a session for each clip and condition. The conditions are tags of the
  sessions. Existing clips are kept, so an interrupted call can be repeated. Errors: `:no_ffmpeg`, `:no_clip`, and the
  errors of the ground truth.
  """
  @spec create_dataset([clip()], Path.t()) :: {:ok, Dataset.t()} | {:error, Error.t()}
  def create_dataset(clips, folder) do
    variants =
      for {clip, index} <- Enum.with_index(clips), condition <- @conditions do
        other = Enum.at(clips, rem(index + 1, length(clips)))
        {clip, other, condition}
      end

    with {:ok, dataset} <- Dataset.new("Who speaks", file: Path.join(folder, "study.json")),
         {:ok, sessions} <- Error.map_ok(variants, &create_session(&1, Path.expand(folder))),
         do: Dataset.save_as(%{dataset | sessions: sessions}, dataset.file)
  end

  defp create_session({{video, truth_file}, {other, other_truth}, condition}, folder) do
    name = "#{Path.basename(video, ".mp4")}-#{condition}"
    path = Path.join([folder, name, "clip.mp4"])

    with {:ok, truth} <- GroundTruth.read(truth_file),
         {:ok, other_truth} <- GroundTruth.read(other_truth),
         :ok <- make_clip(video, other, condition, path),
         {:ok, size} <- image_size(truth_file),
         voices = audible_speech(truth, other_truth, condition),
         truth = adapt_truth(truth, condition, size),
         {:ok, store} <- write_truth(truth, voices, path) do
      session =
        Session.new(name, tags: [to_string(condition)], metadata: %{"faces" => face_boxes(truth)})

      with {:ok, session} <- Session.add_partition(session, Partition.new("Clip", path)),
           do: Session.add_partition(session, Partition.new("Truth", store))
    end
  end

  defp make_clip(video, other, condition, path) do
    if File.exists?(path), do: :ok, else: encode_clip(video, other, condition, path)
  end

  # A clip gets its name when it is complete.
  defp encode_clip(video, other, condition, path) do
    File.mkdir_p!(Path.dirname(path))
    draft = path <> ".unfinished.mp4"

    arguments =
      ["-v", "error", "-y", "-i", video] ++ filter_arguments(condition, other) ++ [draft]

    case run_ffmpeg(arguments) do
      :ok -> File.rename!(draft, path)
      error -> error
    end
  end

  defp run_ffmpeg(arguments) do
    case System.find_executable("ffmpeg") do
      nil ->
        {:error, Error.new(:no_ffmpeg, "ffmpeg is not installed", fix: "run bin/setup")}

      ffmpeg ->
        case System.cmd(ffmpeg, arguments, stderr_to_stdout: true) do
          {_, 0} ->
            :ok

          {text, _} ->
            {:error,
             Error.new(:no_clip, "ffmpeg cannot make a clip", why: String.slice(text, 0, 500))}
        end
    end
  end

  defp filter_arguments(:plain, _other), do: ["-c", "copy"]

  defp filter_arguments(:mirrored, _other),
    do: ["-vf", "hflip", "-c:v", "libx264", "-preset", "veryfast", "-crf", "20", "-c:a", "copy"]

  defp filter_arguments(:noisy, _other),
    do: mix_audio("anoisesrc=color=pink:amplitude=0.05:seed=1:r=16000[n];[0:a][n]")

  defp filter_arguments(:voices, other),
    do:
      ["-i", other] ++
        mix_audio("[1:a]volume=0.2,adelay=#{round(@delay_s * 1000)}:all=1[n];[0:a][n]")

  defp filter_arguments(:dubbed, other) do
    sound = "[1:a]apad[a]"

    ["-i", other, "-filter_complex", sound, "-map", "0:v", "-map", "[a]", "-shortest"] ++
      copy_video()
  end

  defp mix_audio(inputs) do
    filter = inputs <> "amix=inputs=2:duration=first:normalize=0[a]"
    ["-filter_complex", filter, "-map", "0:v", "-map", "[a]"] ++ copy_video()
  end

  defp copy_video, do: ["-c:v", "copy", "-c:a", "aac", "-b:a", "96k", "-ac", "1", "-ar", "16000"]

  defp image_size(truth_file) do
    case truth_file |> File.read!() |> Situ.JSON.decode() do
      {:ok, %{"size" => [width, height]}} ->
        {:ok, {width, height}}

      _ ->
        {:error,
         Error.new(:bad_truth, "#{truth_file} has no size", fix: "add \"size\": [width, height]")}
    end
  end

  defp adapt_truth(truth, :mirrored, {width, _}) do
    faces = for {id, rect} <- truth.faces, do: {id, %{rect | x: width - rect.x - rect.width}}
    %{truth | faces: faces}
  end

  defp adapt_truth(truth, :dubbed, _size), do: %{truth | speech: []}
  defp adapt_truth(truth, _condition, _size), do: truth

  # When anybody is heard, also outside the image.
  defp audible_speech(truth, other, condition) do
    own = if condition == :dubbed, do: [], else: speech_times(truth, 0)

    added =
      case condition do
        :dubbed -> speech_times(other, 0)
        :voices -> speech_times(other, @delay_s)
        _ -> []
      end

    duration = truth.frames / truth.fps
    for {from, to} <- join_times(own ++ added), from < duration, do: {from, min(to, duration)}
  end

  defp speech_times(truth, delay),
    do: for({_, from, to} <- truth.speech, do: {from + delay, to + delay})

  # Overlapping voices are one interval.
  defp join_times(times) do
    times
    |> Enum.sort()
    |> Enum.reduce([], fn
      {from, to}, [{first, last} | rest] when from <= last -> [{first, max(last, to)} | rest]
      time, joined -> [time | joined]
    end)
    |> Enum.reverse()
  end

  defp face_boxes(truth) do
    for {id, rect} <- truth.faces,
        do: %{"id" => id, "box" => [rect.x, rect.y, rect.width, rect.height]}
  end

  defp write_truth(truth, voices, clip) do
    path = Path.join(Path.dirname(clip), "truth")
    schema = Schema.finite("Speech", ["speaks"])
    faces = for {face, from, to} <- truth.speech, face != nil, do: {to_string(face), from, to}
    voices = for {from, to} <- voices, do: {"voice", from, to}

    with {:ok, store} <- Store.open(clip),
         {start, _} = Store.interval(store),
         {:ok, speaking} <- Layer.new(schema, build_annotations(faces, start)),
         {:ok, heard} <- Layer.new(schema, build_annotations(voices, start)) do
      case Store.newest("truth", Path.dirname(clip)) do
        nil -> Recording.write_all(%{"Speaking.Truth" => speaking, "Voice.Truth" => heard}, path)
        existing -> {:ok, existing}
      end
    end
  end

  defp build_annotations(intervals, start) do
    for {track, from, to} <- intervals do
      {from, to} = {start + Situ.Time.s(from / 1), start + Situ.Time.s(to / 1)}
      Annotation.new(from, to, track, %{"Speech" => "speaks"})
    end
  end
end
