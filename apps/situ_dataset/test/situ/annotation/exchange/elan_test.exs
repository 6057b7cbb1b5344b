defmodule Situ.Annotation.Exchange.ElanTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Annotation
  alias Situ.Annotation.{Exchange, Layer, Schema}

  @ms 1_000_000

  # A document as ELAN writes it: all stereotypes, a chain of previous annotations, boundaries without a time, a
  # vocabulary with descriptions, and a participant.
  @document """
  <?xml version="1.0" encoding="UTF-8"?>
  <ANNOTATION_DOCUMENT AUTHOR="" DATE="2025-01-01T10:00:00+01:00" FORMAT="3.0" VERSION="3.0"
      xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" 
      xsi:noNamespaceSchemaLocation="http://www.mpi.nl/tools/elan/EAFv3.0.xsd">
    <HEADER MEDIA_FILE="" TIME_UNITS="milliseconds"><PROPERTY NAME="lastUsedAnnotationId">20</PROPERTY></HEADER>
    <TIME_ORDER>
      <TIME_SLOT TIME_SLOT_ID="ts1" TIME_VALUE="1000"/>
      <TIME_SLOT TIME_SLOT_ID="ts2" TIME_VALUE="1200"/>
      <TIME_SLOT TIME_SLOT_ID="ts3"/>
      <TIME_SLOT TIME_SLOT_ID="ts4" TIME_VALUE="1800"/>
      <TIME_SLOT TIME_SLOT_ID="ts5" TIME_VALUE="2000"/>
    </TIME_ORDER>
    <TIER LINGUISTIC_TYPE_REF="utterance" PARTICIPANT="Ada" ANNOTATOR="Ben" TIER_ID="A-Spch">
      <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a1" TIME_SLOT_REF1="ts1" TIME_SLOT_REF2="ts5">
        <ANNOTATION_VALUE>so you go</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    </TIER>
    <TIER LINGUISTIC_TYPE_REF="parts" PARENT_REF="A-Spch" TIER_ID="A-Parts">
      <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a2" TIME_SLOT_REF1="ts1" TIME_SLOT_REF2="ts3">
        <ANNOTATION_VALUE>p1</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
      <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a3" TIME_SLOT_REF1="ts3" TIME_SLOT_REF2="ts5">
        <ANNOTATION_VALUE>p2</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    </TIER>
    <TIER LINGUISTIC_TYPE_REF="words" PARENT_REF="A-Spch" TIER_ID="A-Words">
      <ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="a4" TIME_SLOT_REF1="ts2" TIME_SLOT_REF2="ts4">
        <ANNOTATION_VALUE>go</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION>
    </TIER>
    <TIER LINGUISTIC_TYPE_REF="morphs" PARENT_REF="A-Words" TIER_ID="A-Morphs">
      <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a6" ANNOTATION_REF="a4" PREVIOUS_ANNOTATION="a5">
        <ANNOTATION_VALUE>o</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
      <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a5" ANNOTATION_REF="a4">
        <ANNOTATION_VALUE>g</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
    </TIER>
    <TIER LINGUISTIC_TYPE_REF="pos" PARENT_REF="A-Morphs" TIER_ID="A-Pos">
      <ANNOTATION><REF_ANNOTATION ANNOTATION_ID="a7" ANNOTATION_REF="a6">
        <ANNOTATION_VALUE>suffix</ANNOTATION_VALUE></REF_ANNOTATION></ANNOTATION>
    </TIER>
    <LINGUISTIC_TYPE LINGUISTIC_TYPE_ID="utterance" TIME_ALIGNABLE="true"/>
    <LINGUISTIC_TYPE CONSTRAINTS="Time_Subdivision" LINGUISTIC_TYPE_ID="parts" TIME_ALIGNABLE="true"/>
    <LINGUISTIC_TYPE CONSTRAINTS="Included_In" LINGUISTIC_TYPE_ID="words" TIME_ALIGNABLE="true"/>
    <LINGUISTIC_TYPE CONSTRAINTS="Symbolic_Subdivision" LINGUISTIC_TYPE_ID="morphs" TIME_ALIGNABLE="false"/>
    <LINGUISTIC_TYPE CONSTRAINTS="Symbolic_Association" CONTROLLED_VOCABULARY_REF="parts of speech"
        LINGUISTIC_TYPE_ID="pos" TIME_ALIGNABLE="false"/>
    <CONTROLLED_VOCABULARY CV_ID="parts of speech"><DESCRIPTION LANG_REF="und"/>
      <CV_ENTRY_ML CVE_ID="c1"><CVE_VALUE DESCRIPTION="the stem" LANG_REF="und">stem</CVE_VALUE></CV_ENTRY_ML>
      <CV_ENTRY_ML CVE_ID="c2"><CVE_VALUE LANG_REF="und">suffix</CVE_VALUE></CV_ENTRY_ML>
    </CONTROLLED_VOCABULARY>
  </ANNOTATION_DOCUMENT>
  """

  defp labels(layer) do
    for a <- Layer.annotations(layer), [text] = Map.values(a.values), into: MapSet.new() do
      {a.track, div(a.from, @ms), div(a.to, @ms), text}
    end
  end

  test "reads all stereotypes, vocabularies and participants" do
    assert {:ok, layer, ["1 boundaries have no time and were interpolated"]} =
             Exchange.decode(@document, :eaf)

    assert labels(layer) ==
             MapSet.new([
               {"A-Spch", 1000, 2000, "so you go"},
               {"A-Parts", 1000, 1500, "p1"},
               {"A-Parts", 1500, 2000, "p2"},
               {"A-Words", 1200, 1800, "go"},
               {"A-Morphs", 1200, 1500, "g"},
               {"A-Morphs", 1500, 1800, "o"},
               {"A-Pos", 1500, 1800, "suffix"}
             ])

    assert Schema.find_tier(layer.schema, "A-Spch").participant == "Ada"
    assert Schema.find_tier(layer.schema, "A-Morphs").relation == :symbolic_subdivision
    pos = Schema.find_attribute(layer.schema, "pos")
    assert [%{value: "stem", description: "the stem"}, %{value: "suffix"}] = pos.values
    assert Enum.find(Layer.annotations(layer), &(&1.track == "A-Spch")).by == "Ben"
  end

  test "writes what it has read" do
    {:ok, layer, _} = Exchange.decode(@document, :eaf)
    {:ok, text, []} = Exchange.encode(layer, :eaf, origin: 0)
    {:ok, again, []} = Exchange.decode(text, :eaf)
    assert again.schema == layer.schema
    assert labels(again) == labels(layer)

    # Without Situ's own copy of the schema in the header, the structure is the same, too.
    foreign = String.replace(text, ~r/<PROPERTY NAME="situ.schema">.*?<\/PROPERTY>/s, "")
    {:ok, again, []} = Exchange.decode(foreign, :eaf)
    assert Enum.sort(again.schema.tiers) == Enum.sort(layer.schema.tiers)
    assert labels(again) == labels(layer)
  end

  test "values and tiers that were added in ELAN extend the schema" do
    {:ok, layer, _} = Exchange.decode(@document, :eaf)
    {:ok, text, []} = Exchange.encode(layer, :eaf, origin: 0)

    edited =
      text
      |> String.replace(
        "</CONTROLLED_VOCABULARY>",
        ~s(<CV_ENTRY_ML CVE_ID="new"><CVE_VALUE LANG_REF="und">prefix</CVE_VALUE></CV_ENTRY_ML></CONTROLLED_VOCABULARY>)
      )
      |> String.replace(">suffix</ANNOTATION_VALUE>", ">prefix</ANNOTATION_VALUE>")
      |> String.replace(
        "    <LINGUISTIC_TYPE",
        ~s(<TIER LINGUISTIC_TYPE_REF="gloss" PARENT_REF="A-Words" TIER_ID="A-Gloss"/><LINGUISTIC_TYPE),
        global: false
      )
      |> String.replace(
        "    <CONSTRAINT",
        ~s(<LINGUISTIC_TYPE CONSTRAINTS="Symbolic_Association" LINGUISTIC_TYPE_ID="gloss"/><CONSTRAINT),
        global: false
      )

    assert {:ok, again, []} = Exchange.decode(edited, :eaf)
    assert {"A-Pos", 1500, 1800, "prefix"} in labels(again)
    assert Schema.find_tier(again.schema, "A-Gloss").relation == :symbolic_association
  end

  test "annotations that break the rules of their tiers are kept on additional tracks" do
    broken = String.replace(@document, ~s(TIME_VALUE="1800"), ~s(TIME_VALUE="900"))
    assert {:ok, layer, losses} = Exchange.decode(broken, :eaf)
    assert Enum.any?(losses, &(&1 =~ "additional tracks"))
    assert [%{values: %{"words" => "go"}}] = Layer.on_track(layer, "A-Words (2)")
  end

  test "a cycle of references ends" do
    cyclic = String.replace(@document, ~s(ANNOTATION_REF="a4"), ~s(ANNOTATION_REF="a7"))
    assert {:ok, _layer, losses} = Exchange.decode(cyclic, :eaf)
    assert Enum.any?(losses, &(&1 =~ "3 annotations have no times"))
  end

  @tag timeout: 10_000
  test "an annotation without a parent is kept on an additional track of its person" do
    document = document([0, 100], [{"Words@Ada", [{0, 1}]}])
    assert {:ok, layer, [loss]} = Exchange.decode(document, :eaf, schema: tiered_schema())
    assert loss =~ "1 annotations overlap with others of their track or have no parent"
    assert [%{from: 0, to: 100_000_000}] = Layer.on_track(layer, "Words (2)@Ada")
  end

  test "an annotation that only touches a parent is not stretched over it" do
    document = document([0, 10, 50], [{"Utt", [{1, 2}]}, {"Words", [{1, 2}]}, {"Cuts", [{0, 1}]}])
    assert {:ok, layer, [_loss]} = Exchange.decode(document, :eaf, schema: tiered_schema())
    assert times(layer, "Cuts (2)") == [{0, 10}]
  end

  test "children that fit stay on their tier, although others overlap with them" do
    spans = [{1, 2}, {1, 3}, {2, 3}, {3, 4}]
    document = document([0, 10, 20, 30, 40, 50], [{"Utt", [{0, 5}]}, {"Words", spans}])
    assert {:ok, layer, [loss]} = Exchange.decode(document, :eaf, schema: tiered_schema())
    assert loss =~ "1 annotations overlap"
    assert times(layer, "Words") == [{10, 20}, {20, 30}, {30, 40}]
    assert times(layer, "Words (2)") == [{10, 30}]
  end

  for {tier, parents} <- [
        {"Words", ~w(Utt)},
        {"Cuts", ~w(Utt Words)},
        {"Morphs", ~w(Utt Words Cuts)}
      ] do
    test "the time to read and write #{tier} is linear in the children of one parent" do
      work = fn count ->
        spans = for i <- 0..(count - 1), do: {i, i + 1}
        tiers = Enum.map(unquote(parents), &{&1, [{0, count}]}) ++ [{unquote(tier), spans}]
        document = document(Enum.to_list(0..count), tiers)

        count_reductions(fn ->
          assert {:ok, layer, []} = Exchange.decode(document, :eaf, schema: tiered_schema())
          assert length(Layer.on_track(layer, unquote(tier))) == count
          {:ok, _text, []} = Exchange.encode(layer, :eaf)
        end)
      end

      assert work.(800) < 6 * work.(200)
    end
  end

  # Returns a document with time slots at these times (ms), and tiers whose annotations last from one slot to another.
  defp document(times, tiers) do
    slots =
      for {ms, i} <- Enum.with_index(times),
          do: ~s(<TIME_SLOT TIME_SLOT_ID="ts#{i}" TIME_VALUE="#{ms}"/>)

    tiers =
      for {name, spans} <- tiers do
        annotations =
          for {from, to} <- spans do
            ~s(<ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="#{name}#{from}-#{to}" ) <>
              ~s(TIME_SLOT_REF1="ts#{from}" TIME_SLOT_REF2="ts#{to}"><ANNOTATION_VALUE>x</ANNOTATION_VALUE>) <>
              "</ALIGNABLE_ANNOTATION></ANNOTATION>"
          end

        ~s(<TIER LINGUISTIC_TYPE_REF="Text" TIER_ID="#{name}">#{annotations}</TIER>)
      end

    "<ANNOTATION_DOCUMENT><TIME_ORDER>#{slots}</TIME_ORDER>#{tiers}</ANNOTATION_DOCUMENT>"
  end

  defp times(layer, track),
    do: for(a <- Layer.on_track(layer, track), do: {div(a.from, @ms), div(a.to, @ms)})

  defp count_reductions(fun) do
    {:reductions, before} = Process.info(self(), :reductions)
    fun.()
    {:reductions, later} = Process.info(self(), :reductions)
    later - before
  end

  defp tiered_schema do
    {:ok, schema} =
      Schema.parse(%{
        "name" => "Speech",
        "attributes" => [
          %{"name" => "Text", "kind" => "text"},
          %{"name" => "Pos", "kind" => "finite", "values" => ["noun", "verb & <x>"]}
        ],
        "tiers" => [
          %{"name" => "Utt", "attribute" => "Text"},
          %{
            "name" => "Words",
            "attribute" => "Text",
            "parent" => "Utt",
            "relation" => "included_in"
          },
          %{
            "name" => "Cuts",
            "attribute" => "Text",
            "parent" => "Words",
            "relation" => "time_subdivision"
          },
          %{
            "name" => "Morphs",
            "attribute" => "Text",
            "parent" => "Cuts",
            "relation" => "symbolic_subdivision"
          },
          %{
            "name" => "Pos",
            "attribute" => "Pos",
            "parent" => "Morphs",
            "relation" => "symbolic_association"
          }
        ]
      })

    schema
  end

  property "a round trip through ELAN and Praat keeps tiers of several people", numtests: 100 do
    tracks = for tier <- ~w(Utt Words Cuts Morphs Pos), p <- ["", "@Ada", "@B <"], do: tier <> p
    items = list({integer(0, 500), integer(1, 400), one_of(tracks), one_of(["", "a b", "ä<&>"])})

    forall items <- items do
      {:ok, empty} = Layer.new(tiered_schema())

      layer =
        Enum.reduce([{0, 300, "Utt", ""}, {10, 200, "Words", "w"} | items], empty, fn
          {from, length, track, text}, layer ->
            values = if track =~ ~r/^Pos/, do: %{"Pos" => "verb & <x>"}, else: %{"Text" => text}
            new = Annotation.new(from * @ms, (from + length) * @ms, track, values)

            case Layer.add(layer, new) do
              {:ok, layer, _} -> layer
              {:error, _} -> layer
            end
        end)

      strip = fn layer ->
        layer
        |> Layer.annotations()
        |> Enum.map(&{&1.from, &1.to, &1.track, &1.values})
        |> Enum.sort()
      end

      # Symbolic annotations have no separate times, so their parts are the same if the aligned ones are whole ms.
      whole? =
        Enum.all?(strip.(layer), fn {from, to, _, _} ->
          rem(from, @ms) == 0 and rem(to, @ms) == 0
        end)

      {:ok, text, _} = Exchange.encode(layer, :eaf, origin: 0)
      {:ok, again, losses} = Exchange.decode(text, :eaf)
      assert losses == []
      assert again.schema == layer.schema
      assert length(strip.(again)) == length(strip.(layer))
      if whole?, do: assert(strip.(again) == strip.(layer))
      {:ok, text, _} = Exchange.encode(layer, :csv)
      {:ok, again, []} = Exchange.decode(text, :csv, schema: layer.schema)
      assert strip.(again) == strip.(layer)
      true
    end
  end
end
