-- Telemetry batches and kept cells, schema 3: how much there is and which number comes next is read from the rows and
-- from the audit chain, so that there is no count beside them which somebody could have edited.

DROP TABLE usage;
